"""Without ``--split``: which splits a command takes of data sets that have or lack them, and the line that says so."""

import json
from pathlib import Path

import pytest

from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.cli.small_path import done
from tests.benchmark.edited_roots import samples_of, small_town, version_of

VAL, ADV = ["scene-8000"], ["scene-8001"]


def town(folder: Path, **splits: list[str]) -> Path:
    """Two scenes with splits of their own; without any both are in ``val``."""
    root = small_town(folder / "town", 2)
    if splits:
        (root / version_of(root) / "splits.json").write_text(json.dumps(splits))
        (root / version_of(root) / "challenger.json").unlink()
    return root


def judged(root: Path, out: Path, *options: str | Path) -> tuple[Done, list[str]]:
    """An evaluation and the splits of its records."""
    models = () if "--plans" in options else ("--model", "stop")
    run = run_here("eval", "--data", root, *models, "--out", out, "--workers", "1", *options)
    return run, sorted(path.parents[1].name for path in out.rglob("run.json"))


def test_eval_takes_val_and_adv_and_says_so_first(tmp_path: Path) -> None:
    root = town(tmp_path, val=VAL, adv=ADV, mine=VAL)
    run, splits = judged(root, tmp_path / "out", "--json")
    assert run.code == 0 and splits == ["adv", "val"] and len(json.loads(run.out)) == 2
    assert run.err.splitlines()[0] == "splits val and adv, the default; --split chooses others"
    run, splits = judged(root, tmp_path / "named", "--split", "mine")
    assert run.code == 0 and splits == ["mine"] and "the default" not in run.err
    (tmp_path / "run.yaml").write_text("split: val\n")
    run, splits = judged(root, tmp_path / "file", "--config", tmp_path / "run.yaml")
    assert run.code == 0 and splits == ["val"] and "the default" not in run.err


@pytest.mark.parametrize(("present", "absent"), [("val", "adv"), ("adv", "val")])
def test_eval_takes_what_there_is(present: str, absent: str, tmp_path: Path) -> None:
    run, splits = judged(town(tmp_path, **{present: VAL}), tmp_path / "out")
    assert run.code == 0 and splits == [present]
    first = run.err.splitlines()[0]
    assert first == f"split {present}; the default is val and adv, but town has no {absent}"


def test_a_data_set_with_neither_is_refused_in_one_sentence(tmp_path: Path) -> None:
    root = town(tmp_path, mine=VAL)
    for command in (("eval", "--model", "stop"), ("drive",), ("sheets",)):
        run = run_here(*command, "--data", root, "--out", tmp_path / "out")
        assert run.code == 2 and run.err.count("\n") == 1, run.err
        assert "town has neither " in run.err and "it has mine: name one with --split" in run.err
    assert not (tmp_path / "out").exists()


def test_other_commands_take_adv_or_what_there_is(tmp_path: Path) -> None:
    both, recorded = town(tmp_path / "both", val=VAL, adv=ADV), town(tmp_path / "recorded")
    for command, of_adv in (("drive", "1 scene of adv"), ("sheets", "town/adv")):
        run = run_here(command, "--data", both, "--out", tmp_path / "out", "--dry-run")
        assert run.code == 0 and of_adv in run.out
        assert run.err.splitlines()[0] == "split adv, the default; --split chooses another"
        run = run_here(command, "--data", recorded, "--out", tmp_path / "out", "--dry-run")
        assert run.code == 0 and "split val; the default is adv, but town has no adv" in run.err


def test_scenes_choose_the_split_that_has_them(tmp_path: Path) -> None:
    root = town(tmp_path, val=VAL, adv=ADV)
    run, splits = judged(root, tmp_path / "out", "--scenes", ADV[0])
    assert splits == ["adv"] and "split adv; the default is val and adv, but val lacks scenes of --scenes" in run.err
    run, _ = judged(root, tmp_path / "none", "--scenes", "scene-800")
    assert run.code == 2 and "did you mean scene-8000" in run.err


def test_a_plan_file_chooses_the_split_of_its_samples(tmp_path: Path) -> None:
    root = town(tmp_path, val=VAL, adv=ADV)

    def plans(scene: str) -> Path:
        path, still = tmp_path / f"{scene}.csv", ",".join(["0"] * 12)
        heads = ",".join(f"{axis}{step}" for step in range(1, 7) for axis in "xy")
        rows = [f"{row['token']},ego,{still}" for row in samples_of(root, scene)]
        path.write_text("\n".join([f"sample_token,frame,{heads}", *rows]))
        return path

    for split, (scene,) in (("val", VAL), ("adv", ADV)):
        file = plans(scene)
        run, splits = judged(root, tmp_path / split, "--plans", file, "--as-is")
        assert run.code == 0 and splits == [split], run.err
        assert f"split {split}; the default is val and adv, but {file} has the samples of {split}" in run.err
    strange = tmp_path / "strange.csv"
    lines = file.read_text().splitlines()
    strange.write_text("\n".join([lines[0], *(f"x{line}" for line in lines[1:])]))
    run, _ = judged(root, tmp_path / "strange", "--plans", strange, "--as-is")
    assert run.code == 2 and "none of its" in run.err and "'val'" in run.err


def test_shards_are_of_each_split(tmp_path: Path) -> None:
    root, out = town(tmp_path, val=VAL, adv=ADV), tmp_path / "out"
    run, splits = judged(root, out, "--shard", "1/1")
    assert run.code == 0 and not splits and run.out.count("shard 1/1, 1 of 1 scene planned") == 2
    (step,) = (line for line in run.err.splitlines() if line.startswith("next:"))
    words = step.partition("   #")[0].split()[2:]
    assert words == ["eval", "--data", str(root), "--model", "stop", "--out", str(out), "--workers", "1"]
    done(run_here(*words))
    assert len([*out.rglob("run.json")]) == 2
