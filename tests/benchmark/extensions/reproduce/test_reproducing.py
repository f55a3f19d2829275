"""The gate for official weights: published numbers beside ours, the verdict on each, and what it marks."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from adapters.models import MODELS
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.extensions.reproduce.reproducing import (
    PUBLISHED,
    compare_run,
    expected_file,
    published_numbers,
    reproduce,
    store_expected,
)  # fmt: skip
from benchmark.planning import Observation, Plan, PlanFrame
from benchmark.published import CHECKPOINTS, PLANNING_ALLOWED, TABLE_1, find_published_results
from benchmark.records.reproduction import (
    REPRODUCTION_FILE,
    ComparedNumber,
    Reproduction,
    find_reproductions,
    version_key,
    with_reproductions,
)  # fmt: skip
from benchmark.records.run import RunRecord
from leaderboard.build import build_leaderboard_files
from leaderboard.extensions.reproduction.tables import reproduction_table
from leaderboard.frame.results import read_results
from leaderboard.tables.collision import run_tables
from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import AHEAD, Failing, Straight
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root


class Drives(Straight):
    """8 m/s, or a share of that, under a protocol of its own."""

    name = "drives"
    native_protocol = "vad"

    def __init__(self, share: float = 1.0, weights: str = "a" * 64, **settings: Any) -> None:
        super().__init__()
        self._share, self.weights_sha256, self.settings = share, weights, settings

    def plan(self, observation: Observation) -> Plan:
        return Plan(self._share * AHEAD, PlanFrame.EGO)


@pytest.fixture(scope="module")
def town() -> FakeData:
    return town_of_two(slow_leader=True)


@pytest.fixture(scope="module")
def values(town: FakeData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the right planner gives, stored."""
    folder = tmp_path_factory.mktemp("first")
    settings = EvalSettings(protocols=("exact", "vad"))
    store_expected(folder / "values.json", evaluate(town, "val", Drives(), folder / "runs", settings), "vad")
    return folder / "values.json"


@pytest.fixture(scope="module")
def reproduced(
    town: FakeData, values: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[RunRecord, Reproduction, Path]:
    out = tmp_path_factory.mktemp("reproduced")
    return *reproduce(town, "val", Drives(), out, expected_file(values, "drives", "val")), out


@pytest.mark.path
def test_the_right_planner_gives_its_numbers_and_marks_runs_of_its_version(
    town: FakeData, reproduced: tuple[RunRecord, Reproduction, Path], tmp_path: Path
) -> None:
    record, found, out = reproduced
    assert found.reproduced and len(found.numbers) == 9
    assert all(number.difference == pytest.approx(0.0, abs=1e-6) for number in found.numbers)
    said = reproduction_table(found).plain(wide=True)
    assert "Verdict: reproduced." in said and "FAIL" not in said and "a run of drives on fake" in said
    elsewhere = replace(town, name="elsewhere")
    later = evaluate(elsewhere, "val", Drives(), tmp_path / "later")
    other = evaluate(elsewhere, "val", Drives(weights="b" * 64), tmp_path / "other")
    options = evaluate(elsewhere, "val", Drives(as_published="memory"), tmp_path / "options")
    known = with_reproductions([record, later, other, options], find_reproductions([out]))
    assert [each.reproduced is not None for each in known] == [True, True, False, False]
    (table, *_) = run_tables("elsewhere", [known[1]])
    assert "drives ✓" in table.plain(wide=True)
    assert "✓ drives: reproduced: the same weights, code and options gave" in table.plain(wide=True)
    assert "✓" not in run_tables("elsewhere", [known[2]])[0].plain(wide=True)
    files = build_leaderboard_files(read_results(known[:2]))
    assert any("✓" in content.decode(errors="ignore") for path, content in files.items() if path.endswith(".md"))


def test_what_failed_somewhere_is_not_marked(reproduced: tuple[RunRecord, Reproduction, Path]) -> None:
    record, right, _ = reproduced
    numbers = [number.model_copy(update={"published": 77.0}) for number in right.numbers]
    wrong = right.model_copy(update={"numbers": numbers})
    assert with_reproductions([record], [right])[0].reproduced
    assert with_reproductions([record], [right, wrong])[0].reproduced is None
    assert with_reproductions([record], [wrong, right])[0].reproduced is None


def test_another_name_of_the_file_is_the_same_version(town: FakeData, tmp_path: Path) -> None:
    named: tuple[dict[str, Any], ...] = (
        {"checkpoint": "one.pth", "checkpoint_sha256": "c"},
        {"checkpoint": "two.pth", "checkpoint_sha256": "c"},
        {"checkpoint": "one.pth", "checkpoint_sha256": "d"},
    )
    facts = [evaluate(town, "val", Drives(**settings), tmp_path).run.planner for settings in named]
    assert version_key(facts[0]) == version_key(facts[1]) != version_key(facts[2])


def test_a_run_that_is_not_whole_says_nothing(town: FakeData, values: Path, tmp_path: Path) -> None:
    class Fails(Failing):
        name = "drives"
        native_protocol = "vad"

    with pytest.raises(InputError, match="failed on 2 of"):
        reproduce(town, "val", Fails(), tmp_path, expected_file(values, "drives", "val"))
    part = evaluate(town, "val", Drives(), tmp_path, EvalSettings(("vad",), limit=1))
    with pytest.raises(InputError, match="covers part of the split"):
        compare_run(part, expected_file(values, "drives", "val"))
    assert not list(tmp_path.rglob(REPRODUCTION_FILE))


def test_fewer_samples_are_another_number(town: FakeData, values: Path, tmp_path: Path) -> None:
    small = FakeData({name: scene for name, scene in town.scenes.items() if name.endswith("2")})
    _, found = reproduce(small, "val", Drives(), tmp_path, expected_file(values, "drives", "val"))
    (samples,) = [number for number in found.numbers if number.column == "samples"]
    assert not samples.ok and samples.ours is not None and samples.ours < samples.published


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"model": "other"}, "is for other on val, not for drives on val"),
        ({"split": "adv"}, "is for drives on adv"),
        ({"protocol": "exakt"}, "unknown protocol 'exakt'"),
        ({"values": {}}, "has no values"),
        ({"allowed": {"l2": 0.1}}, "gives no tolerance for collision"),
        ({"allowed": {"l2": -1.0, "collision": 1.0}}, "allowed"),
        ({"values": {"l2": {"9s": 1.0}}}, "not a file of expected values"),
        ({"more": 1}, "not a file of expected values"),
    ],
)
def test_files_of_expected_values_are_checked(
    change: dict[str, Any], sentence: str, values: Path, tmp_path: Path
) -> None:
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(json.loads(values.read_text()) | change))
    with pytest.raises(InputError, match=sentence):
        expected_file(path, "drives", "val")


def test_damaged_reproductions_are_a_sentence(tmp_path: Path) -> None:
    (tmp_path / REPRODUCTION_FILE).write_text('{"numbers": 3}')
    with pytest.raises(InputError, match="is not a valid reproduction record"):
        find_reproductions([tmp_path])
    assert find_reproductions([tmp_path / "nowhere"]) == []


def test_every_published_model_has_all_its_numbers_with_their_source() -> None:
    for model, protocol, samples in (("uniad", "uniad", 6019.0), ("vad-base", "vad", 5119.0)):
        expected = published_numbers(model, protocol)
        assert expected.of == PUBLISHED and len(expected.numbers) == 9
        assert all(number.values and all(source for _, source in number.values) for number in expected.numbers)
        assert expected.numbers[-1].values[0][0] == samples
    paper = {row.percent for row in TABLE_1 if row.data_set == "nuScenes-val"}
    own = {"uniad": "uniad", "vad-tiny": "vad", "vad-base": "vad"}
    planning = [each for model in CHECKPOINTS for each in find_published_results(model, own.get(model, model))]
    assert paper <= {each.values for each in planning}
    with pytest.raises(InputError, match="did you mean uniad"):
        published_numbers("unaid", "uniad")
    for each in planning:
        *at, average = (float(text) for text in each.values if text) if all(each.values) else (0.0,) * 4
        assert average == pytest.approx(sum(at) / 3, abs=0.012), each


def test_what_is_allowed_is_allowed_to_the_last_bit() -> None:
    def number(ours: float) -> ComparedNumber:
        allowed = PLANNING_ALLOWED["l2"]
        return ComparedNumber(column="l2", horizon="1s", published=0.3, ours=ours, allowed=allowed, source="s")

    assert number(0.32).ok and number(0.28).ok and not number(0.3201).ok
    assert not ComparedNumber(column="l2", horizon="1s", published=0.3, ours=None, allowed=1, source="s").ok


MODEL = "vad-mini"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root") / "recordings"
    write_root(root, [short_scene("scene-0003", seconds=4.5)])
    return root


@pytest.fixture(scope="module")
def stored(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Done]:
    """A first run, whose numbers are stored: out folder, file, and what it printed."""
    out = tmp_path_factory.mktemp("first")
    file, wrong = out / "values.json", out / "of-another-run.json"
    values = {"collision": {"1s": 0.0}, "l2": {"1s": 900.0, "2s": 0.1}}
    first = {"model": MODEL, "protocol": "vad", "split": "val", "source": "nobody", "samples": 3}
    wrong.write_text(json.dumps({**first, "values": values, "allowed": {"collision": 1.0, "l2": 0.02}}))
    return out, file, run_here(*_call(root, out), "--expected", wrong, "--store", file)


def _call(root: Path, out: Path) -> tuple[Any, ...]:
    return ("reproduce", "--model", MODEL, "--data", root, "--out", out)


def test_values_of_another_run_are_not_reproduced(stored: tuple[Path, Path, Done]) -> None:
    _, _, done = stored
    assert done.code == 1
    assert "Verdict: not reproduced" in done.out and "FAIL" in done.out and "1: nobody." in done.out


def test_values_that_were_stored_are_reproduced_and_mark_later_runs(
    root: Path, stored: tuple[Path, Path, Done], tmp_path: Path
) -> None:
    out, file, _ = stored
    done = run_here(*_call(root, out), "--expected", file)
    assert done.code == 0, done.err
    assert "Verdict: reproduced." in done.out and "FAIL" not in done.out
    (found,) = find_reproductions([out / "runs"])
    assert found.planner.settings["as_published"] == "can-after" and found.reproduced
    same = run_here("eval", "--model", MODEL, "--as-published", "all", "--data", root, "--out", out)
    assert "vad-mini (as_published" not in same.out and "§ ✓" in same.out
    assert "the same weights, code and options gave a run of vad-mini" in " ".join(same.out.split())
    other = run_here("eval", "--model", MODEL, "--data", root, "--out", out)
    assert "✓" not in other.out, "without the options of the run it is another version"
    board = run_here("leaderboard", "--out", out, "--to", tmp_path / "board")
    assert board.code == 0
    pages = [path.read_text() for path in (tmp_path / "board").rglob("*.md")]
    assert any("✓" in page for page in pages)


def test_other_weights_are_caught(root: Path, stored: tuple[Path, Path, Done], tmp_path: Path) -> None:
    _, file, _ = stored
    packaged = MODELS[MODEL].packaged
    tensors = load_file(packaged)
    name = next(name for name in tensors if name.endswith("ego_fut_decoder.4.bias"))
    tensors[name] = tensors[name] + 0.1
    other = tmp_path / "other.safetensors"
    with safe_open(packaged, "pt") as opened:
        save_file(tensors, other, opened.metadata())
    done = run_here(*_call(root, tmp_path), "--expected", file, "--checkpoint", other, "--json")
    said = json.loads(done.out)
    assert done.code == 1 and said["reproduced"] is False
    assert [number["horizon"] for number in said["numbers"] if number["column"] == "l2" and not number["ok"]]


def test_a_dry_run_says_what_would_be_compared(root: Path, stored: tuple[Path, Path, Done], tmp_path: Path) -> None:
    _, file, _ = stored
    done = run_here(*_call(root, tmp_path), "--expected", file, "--dry-run")
    assert done.code == 0 and "run vad-mini on 1 scene of val with --as-published can-after" in done.out
    plain = run_here(*_call(root, tmp_path), "--expected", file, "--plain", "--dry-run")
    assert "as eval does by default" in plain.out
    assert not list(tmp_path.iterdir())
