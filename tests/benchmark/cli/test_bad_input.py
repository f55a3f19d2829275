"""Bad input is one clear sentence on stderr, nothing on stdout, and exit code 2."""

import json
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.benchmark.cli.cli_runs import Run, refusal, run_main
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import scene_on_straight_road

VERSION = "v1.0-mini"


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "road"
    return write_root(root, [scene_on_straight_road()], version=VERSION, renderer=None).root


@pytest.fixture
def broken(good: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(good, tmp_path / "road"))


def assert_one_sentence(run: Run, *words: str) -> None:
    assert run.code == 2, run
    assert run.out == ""
    assert run.err.startswith("error: ") and run.err.count("\n") == 1, run.err
    assert "Traceback" not in run.err
    for word in words:
        assert word in run.err, run.err


def evaluate(root: Path, out: Path, *more: str | Path) -> Run:
    model = () if "--plans" in more else ("--model", "constant-velocity")
    return run_main("eval", "--data", root, "--split", "val", "--out", out, *model, *more)


def test_the_good_data_set_is_good(good: Path, tmp_path: Path) -> None:
    run = evaluate(good, tmp_path / "out")
    assert run.code == 0, run.err
    assert "constant-velocity" in run.out


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (("eval", "--model", "idm"), "--split"),
        (("sheets",), "--split"),
        (("generate", "--renderer", "none"), "--source-split"),
        (("ablate",), "--source-split"),
    ],
)
def test_adversarial_scenes_are_never_val(
    broken: Path, tmp_path: Path, arguments: tuple[str, ...], option: str
) -> None:
    """As `generate` and `demo` write them: `splits.json` has adv alone; `val` is the default, and may be named."""
    (broken / VERSION / "splits.json").write_text('{"adv": ["scene-9901"]}')
    (broken / VERSION / "challenger.json").write_text('{"split": "adv", "scenes": {"scene-9901": {}}}')
    for named in ((), (option, "val")):
        said = refusal(*arguments, *named, "--data", broken, "--out", tmp_path / "out")
        assert said.endswith("road has no split 'val'; the only one is adv")
    assert not (tmp_path / "out" / "runs").exists()


def test_split_not_generated_yet(good: Path, tmp_path: Path) -> None:
    run = run_main("eval", "--data", good, "--split", "adv", "--out", tmp_path, "--model", "idm")
    assert_one_sentence(run, "generate", "adv")


@pytest.mark.parametrize(
    "arguments",
    [("eval", "--limit", "0"), ("generate", "--layout", "zz"), ("generate", "--candidates", "1000000"), ("fly",)],
    ids=["too-small", "no-such-choice", "too-large", "no-such-command"],
)
def test_wrong_use(arguments: tuple[str, ...]) -> None:
    assert_one_sentence(run_main(*arguments))


def test_a_pickle_that_runs_code_is_refused_and_does_not_run(tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, (str(tmp_path / "ran"),)

    (tmp_path / "sd_evil.pkl").write_bytes(pickle.dumps({"id": "x", "tracks": Evil()}))
    run = run_main("data", "import", "scenarionet", tmp_path, "--out", tmp_path / "out")
    assert_one_sentence(run, "sd_evil.pkl", "mkdir")
    assert not (tmp_path / "ran").exists()


def plan_rows(root: Path) -> list[dict[str, object]]:
    tokens = [row["token"] for row in json.loads((root / VERSION / "sample.json").read_text())]
    waypoints = {f"{axis}{step}": 0.0 for step in range(1, 7) for axis in "xy"}
    return [{"sample_token": token, "frame": "lidar", **waypoints} for token in tokens]


def test_plans_of_a_file_have_the_name_that_was_asked_for(good: Path, tmp_path: Path) -> None:
    rows = plan_rows(good)
    text = "\n".join([",".join(rows[0]), *(",".join(map(str, row.values())) for row in rows)])
    plans = tmp_path / "plans.csv"
    plans.write_text(text + "\n")
    run = evaluate(good, tmp_path / "out", "--plans", plans, "--as-is", "--name", "mine", "--json")
    assert run.code == 0 and Path(run.json[0]["directory"]).name == "mine", run.err


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        (lambda rows: rows.pop(), "no row"),
        (lambda rows: rows.append(dict(rows[0])), "more than one"),
        (lambda rows: rows.append({**rows[0], "sample_token": "0" * 32}), "0" * 32),
        (lambda rows: rows[1].update(x3=float("nan")), "not finite"),
        (lambda rows: rows[1].update(x3=1e300), "farther than"),
    ],
    ids=["missing", "duplicate", "extra", "not-finite", "global-coordinates"],
)
def test_plan_file_faults(
    good: Path, tmp_path: Path, fault: Callable[[list[dict[str, object]]], None], word: str
) -> None:
    rows = plan_rows(good)
    fault(rows)
    columns = list(rows[0])
    text = "\n".join([",".join(columns), *(",".join(str(row[name]) for name in columns) for row in rows)])
    plans = tmp_path / "plans.csv"
    plans.write_text(text + "\n")
    run = evaluate(good, tmp_path / "out", "--plans", plans)
    assert_one_sentence(run, "plans.csv", word)
