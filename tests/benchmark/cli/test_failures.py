"""``failures``: a planner's worst scenes and samples from its record, and the commands that it names."""

import json
from pathlib import Path

import pytest

from benchmark.records.run import RunRecord, write_record
from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.metrics.made_attacks import attacked, told
from tests.benchmark.records.hand_made_records import facts_of
from tests.benchmark.records.test_drives import contact, failed, row, written

SCENES = {"A-1": "F.r.", "A-2": "..!s", "B-1": "f-.."}


def stored(out: Path, planner: str, scenes: dict[str, str] = SCENES, data: str = "mini", part: str = "") -> RunRecord:
    """A record where `eval` writes it; ``part`` tells it from another one of the planner."""
    run = told(attacked(planner, scenes, dict.fromkeys(scenes, True), data=data))
    folder = out / "runs" / data / "adv" / f"{planner}{part}"
    return write_record(folder, facts_of(run.run), list(run.rows), run.run.protocols, seed=0)


def failures(out: Path, *more: str, data: str = "nowhere/d") -> Done:
    return run_here("failures", "--data", data, "--out", out, *more)


def test_the_worst_come_first_with_whom_they_hit_and_the_command_that_films_them(tmp_path: Path) -> None:
    stored(tmp_path, "p", data="d")
    done = failures(tmp_path, "--model", "p", "--limit", "2")
    assert done.code == 0, done.err
    lines = done.out.splitlines()
    assert lines[0].startswith("p on d adv (exact, 3 s): 4 of 10 samples fail, in 3 of 3 scenes; 3 with the adversary")
    shown = " ".join(done.out.split())
    assert "an object, the adversary yes 0 0.0 1.3 5.0" in shown and "A-2 2 RuntimeError" in shown
    assert f"all tracebacks: {tmp_path / 'runs' / 'd' / 'adv' / 'p' / 'failures.txt'}" in lines
    again = f"--split adv --data nowhere/d --out {tmp_path} --scenes"
    commands = [line.strip().split(" && ") for line in lines[lines.index("to see each scene:") + 1 :]]
    assert [command[0] for command in commands] == [
        f"challenger-bench sheets {again} {name}" for name in ("B-1", "A-2")
    ]
    assert all(command[1].startswith(f"challenger-bench film {again}") for command in commands)
    # The data set is not here: the record is enough, and one line says what is missing.
    assert done.err.startswith("categories are not shown: there is no folder nowhere/d") and done.err.count("\n") == 1


def test_it_is_data_for_programs(tmp_path: Path) -> None:
    stored(tmp_path, "p", data="d")
    (said,) = json.loads(failures(tmp_path, "--model", "p", "--json").out)
    assert {name: said[name] for name in ("failed", "counted", "scenes_failed", "without_plan", "unit")} == {
        "failed": 4, "counted": 10, "scenes_failed": 3, "without_plan": 1, "unit": "sample"
    }  # fmt: skip
    worst = {"scene": "B-1", "index": 0, "sample_token": "B-1-0", "adversary": True, "at_fault": True, "hit": "a"}
    assert worst.items() <= said["worst"][0].items() and said["scenes"][0]["worst"] == said["worst"][0]
    assert said["crashes"][0]["raised"] == "RuntimeError" and len(said["scenes"][0]["film"]) == 2


def test_without_a_failure_it_says_so(tmp_path: Path) -> None:
    stored(tmp_path, "p", {"A-1": "...."}, data="d")
    done = failures(tmp_path, "--model", "p")
    assert done.code == 0 and done.out == "p on d adv (exact, 3 s): no failure in 4 samples of 1 scene\n"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "name a planner with --model; found records of mini (adv: vad-mini)"),
        (("--model", "VAD-mini"), "did you mean vad-mini, "),
        (("--model", "idm"), "make it with: challenger-bench eval --model idm --split adv --out {out}"),
        (("--model", "vad", "--split", "val"), "challenger-bench eval --model vad --split val --out {out}"),
        (("--model", "mine:Planner"), "challenger-bench eval --model mine:Planner --split adv --out {out}"),
        (("--model", "vad-mini", "--drives"), "drive --model vad-mini --split adv --sensor schematic --out {out}"),
        (("--model", "idm", "--drives", "--data", "demo"), "drive --model idm --split adv --data demo --out {out}"),
    ],
)
def test_without_a_record_the_command_that_makes_it_is_named(
    tmp_path: Path, arguments: tuple[str, ...], says: str
) -> None:
    stored(tmp_path, "vad-mini")
    done = failures(tmp_path, *arguments, data="mini")
    assert (done.code, done.out) == (2, "") and done.err.count("\n") == 1
    assert says.format(out=tmp_path) in done.err


def test_a_full_model_is_its_miniature_and_a_whole_run_goes_before_a_part(tmp_path: Path) -> None:
    stored(tmp_path, "vad-mini", data="d")
    part = stored(tmp_path, "vad-mini", {"A-1": "ff.."}, data="d", part="-part")
    path = part.directory / "run.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "scenes_in_split": 3}))
    done = failures(tmp_path, "--model", "vad")
    assert done.code == 0 and "vad-mini on d adv (exact, 3 s): 4 of 10 samples fail" in done.out
    assert "vad ran as vad-mini" in done.err


def test_drives_of_several_worlds_are_told_apart(tmp_path: Path) -> None:
    for agents in ("replay", "idm"):
        measured = {"engine": "default", "agents": agents, "sensor": "none"}
        written(
            tmp_path / "drives" / "fake" / "adv" / agents / "made",
            row(end="contact", contact=contact()),
            failed(),
            measured=measured,
        )
    done = failures(tmp_path, "--model", "made", "--drives", data="fake")
    assert done.code == 0, done.err
    assert done.out.count("1 of 1 drive touches something") == 2 and "agents idm" in done.out
    assert "vehicle.car, the adversary" in done.out and "ValueError: no" in done.out
    films = [line for line in done.out.splitlines() if "challenger-bench film --drives" in line]
    assert len(films) == 2 and all(f"--records {tmp_path}/drives/fake/adv/" in film for film in films)
