"""The gate for official weights: published numbers beside ours, the verdict on each, and what it marks."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

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
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import AHEAD, Failing, Straight


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


def test_another_planner_does_not_give_them(town: FakeData, values: Path, tmp_path: Path) -> None:
    record, found = reproduce(town, "val", Drives(0.9), tmp_path / "runs", expected_file(values, "drives", "val"))
    assert not found.reproduced
    by_name = {(number.column, number.horizon): number for number in found.numbers}
    assert not by_name["l2", "3s"].ok and by_name["samples", ""].ok
    assert "Verdict: not reproduced" in reproduction_table(found).plain(wide=True)
    (known,) = with_reproductions([record], find_reproductions([tmp_path / "runs"]))
    assert known.reproduced is None


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
