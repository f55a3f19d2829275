"""Commands on roots that lack truth: the sentence, the mark, the exit code."""

import shutil
from pathlib import Path

import pytest

from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.edited_roots import copy_of, rename_categories, small_town, without_annotations

SCENES = ("scene-8000", "scene-8001")


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("town") / "town", len(SCENES))


@pytest.fixture(scope="module")
def empty(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = copy_of(town, tmp_path_factory.mktemp("empty") / "town")
    without_annotations(root)
    return root


@pytest.fixture(scope="module")
def foreign(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = copy_of(town, tmp_path_factory.mktemp("foreign") / "town")
    rename_categories(root, lambda name: name.replace(".", "_"))
    return root


def evaluated(root: Path, out: Path, *more: str) -> Done:
    model = ("--model", "constant-velocity", "--workers", "1")
    return run_here("eval", *model, "--data", root, "--split", "val", "--out", out, *more)


@pytest.mark.parametrize(
    "command",
    [
        ("eval", "--model", "stop", "--split", "val"),
        ("drive", "--model", "stop", "--no-baselines", "--split", "val"),
        ("generate", "--renderer", "none"),
        ("generate", "--renderer", "none", "--split", "val-r"),
    ],
)
def test_nothing_that_is_labelled_is_refused(command: tuple[str, ...], empty: Path, tmp_path: Path) -> None:
    done = run_here(*command, "--data", empty, "--out", tmp_path)
    assert done.code == 2 and "none of them has an annotation" in done.err, done
    assert not list(tmp_path.rglob("*.json*"))


def test_a_scene_without_annotations_is_warned_about_once_and_marks_the_row(town: Path, tmp_path: Path) -> None:
    root = copy_of(town, tmp_path / "one")
    without_annotations(root, {SCENES[1]})
    done = evaluated(root, tmp_path / "out")
    assert done.code == 0 and done.err.count("warning: ") == 1
    said = "1 of 2 scenes (scene-8001) has no annotations: collision rates and counts of failed scenes exclude them"
    assert f"warning: constant-velocity: {said}" in done.err
    assert "constant-velocity ¶" in done.out and said[:40] in done.out
    assert evaluated(town, tmp_path / "sound").err.count("warning: ") == 0


def test_unknown_categories_are_dashes_unless_a_judge_that_goes_by_them_is_named(foreign: Path, tmp_path: Path) -> None:
    done = evaluated(foreign, tmp_path / "out", "--limit", "1")
    assert done.code == 0 and "unknown categories ('vehicle_car', " in done.err
    named = evaluated(foreign, tmp_path / "out", "--limit", "1", "--protocol", "uniad")
    assert named.code == 2 and "uniad, which depends on categories" in named.err
    own = run_here("eval", "--model", "vad-mini", "--data", foreign, "--split", "val", "--out", tmp_path / "out")
    assert own.code == 2 and "vad, which depends on categories" in own.err
    assert evaluated(foreign, tmp_path / "out", "--limit", "1", "--protocol", "exact").code == 0
    assert evaluated(foreign, tmp_path / "out", "--limit", "1", "--protocol", "all").code == 0


def test_a_map_of_categories_is_taken_by_name_and_refused_before_anything_else(foreign: Path, tmp_path: Path) -> None:
    done = evaluated(foreign, tmp_path / "out", "--limit", "1", "--protocol", "uniad", "--categories", "short")
    assert done.code == 0 and "warning" not in done.err and "--categories short" in done.err
    assert run_here("data", "check", foreign, "--categories", "short").out.startswith("0 errors, 0 warnings")
    for command in (("eval", "--model", "stop"), ("drive",), ("generate",)):
        done = run_here(*command, "--categories", "shirt", "--data", foreign, "--out", tmp_path / "other")
        assert done.code == 2 and "did you mean short?" in done.err


def test_a_missing_map_is_said_once_for_each_planner_and_marks_the_row(town: Path, tmp_path: Path) -> None:
    root = copy_of(town, tmp_path / "data" / "root")
    shutil.move(root / "maps" / "expansion", tmp_path / "data" / "expansion")
    checked = run_here("data", "check", root)
    assert checked.code == 0 and "lies at ../expansion/boston-seaport.json" in checked.out
    done = run_here(
        "eval", "--data", root, "--model", "idm", "--model", "stop", "--limit", "1", "--out", tmp_path / "out"
    )
    warnings = [line for line in done.err.splitlines() if line.startswith("warning: ")]
    assert done.code == 0 and [line.split(":")[1] for line in warnings] == [" idm", " stop"]
    assert (
        "idm † ¶" in done.out
        and "drives straight instead" in warnings[0]
        and "drives straight instead" not in warnings[1]
    )
    sound = run_here("eval", "--data", town, "--model", "idm", "--limit", "1", "--out", tmp_path / "sound")
    assert sound.code == 0 and "warning" not in sound.err and "¶" not in sound.out
