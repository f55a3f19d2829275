"""Broken, misplaced and malicious result files: each is refused in one sentence of its kind, and nothing runs."""

import os
import re
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from adapters.registry import planner_factory
from adapters.result_files.importing import import_results
from adapters.result_files.planner import result_file_factory
from adapters.result_files.recognition import FORMATS, recognise, require_format
from adapters.result_files.samples import read_recorded_samples
from adapters.result_files.writing.formats import require_writable, write_results
from benchmark.errors import InputError
from benchmark.evaluation import evaluate
from benchmark.untrusted.files import CATEGORIES, RefusedFileError
from tests.adapters.result_files.broken_files import BROKEN, HOSTILE, SAMPLES, Broken, valid
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.fake_data import FakeData
from tests.documentation.lines_of_code import ROOT
from tests.hand_made import scene_on_straight_road


def test_there_are_enough_kinds_of_all_categories() -> None:
    assert len({broken.name for broken in BROKEN}) == len(BROKEN) >= 40
    assert {category for broken in BROKEN for category in broken.categories} == set(CATEGORIES)


@pytest.mark.parametrize("broken", BROKEN, ids=lambda broken: broken.name)
def test_each_is_one_sentence_of_its_kind(broken: Broken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = broken.make(tmp_path)
    monkeypatch.setattr(os, "getcwd", called)
    monkeypatch.setattr("posix.getcwd", called)
    began = time.process_time()
    with pytest.raises(RefusedFileError) as refused:
        import_results([recognise(path)], SAMPLES)
    assert refused.value.category in broken.categories, str(refused.value)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value) and len(str(refused.value)) < 500
    assert time.process_time() - began < 10


def called() -> str:
    raise AssertionError("something of a file was run")


@pytest.mark.parametrize("broken", HOSTILE[::6], ids=lambda broken: broken.name)
def test_the_command_refuses_it_before_anything_is_built_and_writes_nothing(
    broken: Broken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = broken.make(tmp_path)
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    sentence = refusal("eval", "--results", path, "--out", tmp_path / "out")
    assert str(path) in sentence and "\n" not in sentence
    assert not (tmp_path / "out").exists() and not (tmp_path / "cache").exists()


def test_wrong_use_says_what_there_is(tmp_path: Path) -> None:
    path = valid("pred-trajs", tmp_path)
    assert recognise(path, "pred-trajs").format.name == "pred-trajs"
    wrong: tuple[tuple[Callable[[], object], str], ...] = (
        (lambda: require_format("unaid"), "did you mean uniad"),
        (lambda: require_format("law-out"), "no plan"),
        (lambda: require_writable("vad"), "did you mean vad-results or vad-out"),
        (lambda: require_writable("agent-driver"), r"did you mean pred-trajs\?"),
        (lambda: require_writable("law-out"), "no plan"),
        (lambda: recognise(Path("nowhere.pkl")), "there is no result file"),
        (lambda: recognise(path, "uniad"), "has the format pred-trajs, not uniad"),
    )
    for act, says in wrong:
        with pytest.raises(InputError, match=says):
            act()


def test_files_of_two_formats_or_without_tokens_are_not_judged_together(tmp_path: Path) -> None:
    opened = {name: recognise(valid(name, tmp_path)) for name in ("pred-trajs", "uniad", "sparsedrive")}
    with pytest.raises(InputError, match="one by one"):
        import_results([opened["pred-trajs"], opened["uniad"]], SAMPLES)
    with pytest.raises(InputError, match="name no samples"):
        import_results([opened["sparsedrive"], opened["sparsedrive"]], SAMPLES)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("uniad", r"16 of its 16 samples, .* are samples of split 'train', not of split 'val' of fake; score it with"),
        ("sparsedrive", r"16 entries without tokens, and split 'val' of fake has 10 samples; split 'train' has 16;"),
    ],
)
def test_a_file_of_another_split_is_told_which(name: str, says: str, tmp_path: Path) -> None:
    scenes = {each: scene_on_straight_road(name=each, seconds=s) for each, s in (("scene-1", 8.0), ("scene-2", 5.0))}
    data = FakeData(scenes, train=("scene-1",))
    record = evaluate(data, "train", planner_factory("constant-velocity"), tmp_path / "runs")
    path = write_results(record, read_recorded_samples(data, "train"), name, tmp_path / name)
    assert result_file_factory([recognise(path)], data, "train").facts.name
    with pytest.raises(RefusedFileError, match=f"{says}.*--split train"):
        result_file_factory([recognise(path)], data, "val")


def test_pages_count_the_repositories_that_there_are() -> None:
    planners = frozenset[str]().union(*(each.planners for each in FORMATS.values()))
    words = {"eight": 8, "nine": 9, "ten": 10, "eleven": 11}
    said = re.compile(r" of (UniAD, VAD[\w, -]*) and (\w+) (?:more|others)")
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        for named, more in said.findall(page.read_text()):
            assert len(named.split(", ")) + words[more] == len(planners) == 14, page
