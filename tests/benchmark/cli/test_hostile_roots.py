"""Roots that `data check` calls wrong are refused by each command that reads them, and nothing is written."""

import json
from pathlib import Path

import pytest

from tests.benchmark.cli.cli_runs import refusal, run_main
from tests.benchmark.datasets.hostile_tables import HOSTILE_ROOTS, slower
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.hand_made import scene_on_straight_road

COMMANDS = {
    "eval": ("eval", "--split", "val", "--model", "constant-velocity"),
    "generate": ("generate", "--split", "adv"),
    "sheets": ("sheets", "--split", "val"),
    "data show": ("data", "show"),
}
FELL = (
    "sample.timestamp is text",
    "scene.name is a surrogate",
    "ego_pose.translation is NaN",
    "a shared table nested deeply",
)
"""Of what once ended with a traceback, or with numbers: tests/benchmark/datasets/test_bad_tables.py has all."""


def hostile(root: Path, name: str) -> Path:
    TinyRoot.of(root, [scene_on_straight_road(seconds=4.0)]).write()
    next(variant for variant in HOSTILE_ROOTS if variant.name == name).damage(root)
    return root


def told(command: str, root: Path, out: Path) -> str:
    given = (root, "--to", out) if command == "data show" else ("--data", root, "--out", out)
    return refusal(*COMMANDS[command], *given)


@pytest.mark.parametrize("name", FELL)
def test_every_command_refuses_with_the_same_sentence(tmp_path: Path, name: str) -> None:
    root, out = hostile(tmp_path / "root", name), tmp_path / "out"
    sentences = {told(command, root, out) for command in COMMANDS}
    assert len(sentences) == 1
    [sentence] = sentences
    assert str(root) in sentence and sentence.isprintable()
    assert not out.exists()


def test_another_keyframe_rate_can_be_looked_at_with_a_warning(tmp_path: Path) -> None:
    root = TinyRoot.of(tmp_path / "root", [scene_on_straight_road(seconds=4.0)]).write()
    slower(2)(root)
    info = run_main("data", "info", root)
    assert info.code == 0 and "scene-9901" in info.out
    assert info.err.startswith("warning: the keyframes of scene-9901 are 1 s apart") and info.err.count("\n") == 1
    show = run_main("data", "show", root, "--to", tmp_path / "out")
    assert show.code == 0 and "1 picture in" in show.out and show.err.startswith("warning: ")


@pytest.mark.parametrize("split", ["val", "mine"])
def test_a_broken_list_of_splits_is_said_whatever_split_is_asked_for(tmp_path: Path, split: str) -> None:
    root = TinyRoot.of(tmp_path / "root", [scene_on_straight_road(seconds=4.0)]).write()
    for names, says in (
        (["scene-9901"] * 2, "lists a scene twice"),
        (["scene-9902"], "no such scene"),
        ([], "is empty"),
    ):
        (root / "splits.json").write_text(json.dumps({split: names}))
        asked = ("--split", split, "--data", root, "--out", tmp_path / "out")
        for command in (("eval", "--model", "constant-velocity"), ("sheets",)):
            assert says in refusal(*command, *asked)
    (root / "splits.json").write_text("{}")
    assert "build it with" in refusal("sheets", "--split", "adv", "--data", root, "--out", tmp_path / "out")
