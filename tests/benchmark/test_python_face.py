"""The public face: every name, every command, and the examples of the documentation."""

import doctest
import importlib
import os
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

import benchmark
from benchmark.cli.app import app
from generation.sources.town import DEFAULT_VAL_SCENES
from generation.splits.packaged import read_newest_split
from tests.whole_product import command_is_installed, is_installed

PLACES: dict[str, str] = vars(benchmark)["_PLACES"]
SHOWN: list[str] = vars(benchmark)["__all__"]
HERE = {name: place for name, place in PLACES.items() if is_installed(place)}
"""Names of what is installed."""
ROOT = Path(__file__).resolve().parents[2]
FUNCTION_OF = {
    "generate": "generate", "ablate": "ablate", "eval": "evaluate", "drive": "drive_split", "serve": "serve_planner",
    "models": "known_planners", "rescore": "rescore_all", "transfer": "transfer_matrices",
    "failures": "find_failures",
    "quality": "measure_quality", "sheets": "write_sheets", "film": "write_films", "reproduce": "reproduce",
    "verify": "verify", "demo": "demo", "doctor": "doctor", "data info": "data_contents",
    "data export infos": "export_infos", "data export scenarionet": "export_scenarionet",
    "data export openscenario": "export_openscenario", "data export nuscenes": "export_nuscenes",
    "data export mcap": "export_mcap",
    "data pack": "pack_split", "data unpack": "read_split_package",
    "data stats": "data_statistics", "data show": "write_pictures", "data card": "write_data_card",
    "data check": "check_data", "data review": "record_verdicts",
    "data import scenarionet": "import_scenarionet", "data import 123d": "import_123d",
    "data build": "build_town", "train denoiser": "train_denoiser", "train planner": "train_planner",
    "train judge": "judge_again", "train ego-status": "train_ego_status", "weights list": "known_weights",
    "weights import": "import_weights", "weights fetch": "fetch_weights", "weights anchors": "write_anchors",
    "leaderboard": "write_leaderboard", "challenge check": "check_challenge", "challenge score": "score_challenge",
    "challenge rules": "challenge_rules", "leaderboard slices": "slice_tables",
    "leaderboard submit-check": "check_submission", "leaderboard card": "write_records_card",
    "leaderboard export-alpasim": "build_alpasim_table",
    "leaderboard ability": "fit_abilities", "leaderboard next": "choose_next_scenes",
}  # fmt: skip


def commands(command: Any, name: str = "") -> Iterator[str]:
    """Names of all commands that can be given, groups that do something themselves included."""
    parts = getattr(command, "commands", {})
    if name and (not parts or getattr(command, "invoke_without_command", False)):
        yield name
    for part, inner in parts.items():
        yield from commands(inner, f"{name} {part}".strip())


def test_every_command_has_its_function() -> None:
    here = {command: function for command, function in FUNCTION_OF.items() if command_is_installed(command)}
    found = filter(command_is_installed, commands(typer.main.get_command(app)))
    assert set(found) == set(here)
    page = (ROOT / "docs" / "python.md").read_text()
    for function in here.values():
        assert callable(getattr(benchmark, function)) and f"`{function}`" in page


def test_every_name_is_there_and_documented() -> None:
    for name in HERE:
        assert getattr(benchmark, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = getattr(benchmark, "nothing")  # noqa: B009 - for type checkers there is no such name


def test_sixty_names_are_shown_none_of_them_astray() -> None:
    assert len(set(SHOWN)) == len(SHOWN) <= 60
    assert set(SHOWN) - {"__version__"} <= set(PLACES)
    assert dir(benchmark) == sorted(SHOWN)


def test_no_name_is_that_of_a_submodule() -> None:
    # Importing the submodule would put it in the place of the name.
    assert not {module.name for module in pkgutil.iter_modules(benchmark.__path__)} & set(PLACES)


def test_a_name_is_what_its_place_defines() -> None:
    for name, place in HERE.items():
        module, _, original = place.partition(":")
        assert getattr(benchmark, name) is getattr(importlib.import_module(module), original)


def test_importing_it_is_light_and_a_star_imports_what_is_shown() -> None:
    program = "import sys, benchmark; assert not {'numpy', 'pydantic', 'typer', 'torch'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)
    star: dict[str, object] = {}
    exec("from benchmark import *", star)
    assert star["evaluate"] is benchmark.evaluate and set(SHOWN) <= set(star)


ONE_SCENE = """
import generation.sources.town as town
import generation.splits.cached as cached
from generation.splits.packaged import NamedSplit, read_newest_split

whole = read_newest_split("mini")
one = min(whole.frozen.scenes, key=lambda scene: scene.name)
town.DEFAULT_VAL_SCENES = int(one.source[-4:]) - 7999
few = NamedSplit(whole.name, whole.frozen.model_copy(update={"scenes": (one,)}))
cached.read_newest_split = lambda *_: few
"""


def examples(page: str) -> str:
    return "\n".join(re.findall(r"```python\n(>>>.*?)```", (ROOT / page).read_text(), re.DOTALL))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def test_the_examples_of_the_documentation_run_as_a_plain_script(cache: Path, tmp_path: Path) -> None:
    """Up to the first evaluation: without a guard of ``__main__``, a planner of the script, nothing built yet."""
    parts = [example.source for example in doctest.DocTestParser().get_examples(examples("docs/python.md"))]
    last = next(number for number, part in enumerate(parts) if "benchmark.evaluate(" in part)
    (tmp_path / "script.py").write_text(ONE_SCENE + "".join(parts[: last + 1]))
    # Processes are started wherever a reader's first script starts them.
    environment = os.environ | {"PYTHONPATH": str(ROOT), "CHALLENGER_BENCH_CACHE": str(cache)}
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "challenger-out" / "runs").rglob("run.json"))) == 1


def test_the_examples_run(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = "docs/python.md"
    # Both are put back after the test.
    monkeypatch.setattr("generation.sources.town.DEFAULT_VAL_SCENES", DEFAULT_VAL_SCENES)
    monkeypatch.setattr("generation.splits.cached.read_newest_split", read_newest_split)
    exec(ONE_SCENE, {})
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(cache))
    monkeypatch.chdir(tmp_path)
    test = doctest.DocTestParser().get_doctest(examples(page), {}, page, page, 0)
    assert test.examples
    said: list[str] = []
    assert doctest.DocTestRunner().run(test, out=said.append).failed == 0, "".join(said)
