"""The whole path through the command line on a tiny town: build, check, generate, evaluate, transfer, tables."""

import json
import shlex
import shutil
from pathlib import Path

import pytest

from benchmark.records.run import load_record
from leaderboard.tables.collision import run_tables
from tests.benchmark.cli.cli_runs import Run, bytes_below, run_main
from tests.benchmark.cli.small_path import SMALL

SEARCH = ("--preset", "near", "--candidates", "32", "--rounds", "2", "--vehicles", "4")
PLANNERS = ("constant-velocity", "log-replay")


def done(run: Run) -> Run:
    assert run.code == 0, run.err
    return run


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("town") / "small"
    done(run_main("data", "build", "--root", root, "--town-scenes", "1", *SMALL, "--workers", "1"))
    return root


@pytest.fixture(scope="module")
def out(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    for split, search in (("adv", SEARCH), ("val-r", ())):
        common = ("--data", town, "--split", split, "--out", folder, *SMALL, *search, "--workers", "1")
        done(run_main("generate", *common))
    models = [part for name in PLANNERS for part in ("--model", name)]
    for split in ("val", "val-r", "adv"):
        done(run_main("eval", *models, "--data", town, "--split", split, "--out", folder, "--workers", "1"))
    return folder


def rate(out: Path, split: str, planner: str) -> float:
    files = list((out / "runs").rglob("summary.json"))
    path = next(path for path in files if path.parent.parent.name == split and path.parent.name.startswith(planner))
    return float(json.loads(path.read_text())["protocols"]["exact"]["columns"]["collision"]["avg"]["value"])


def test_adversaries_make_planners_collide_and_the_recorded_ego_never(out: Path) -> None:
    assert rate(out, "adv", "log-replay") == rate(out, "val", "log-replay") == 0.0
    assert rate(out, "adv", "constant-velocity") > rate(out, "val", "constant-velocity")


def test_originals_rendered_again_score_like_the_originals(out: Path) -> None:
    for planner in PLANNERS:
        assert rate(out, "val-r", planner) == rate(out, "val", planner)


def test_what_is_written_has_no_faults(town: Path, out: Path) -> None:
    for root in (town, out / "data" / "small" / "adv"):
        run = done(run_main("data", "check", root, "--json"))
        assert run.json == {"errors": 0, "faults": []}


def test_the_command_that_shows_a_failure_works_as_printed(
    town: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on = ("--model", "constant-velocity", "--data", town, "--out", out)
    listed = done(run_main("failures", *on))
    assert " samples fail, in " in listed.out and "vehicle.car, the adversary" in listed.out and listed.err == ""
    commands = listed.out[listed.out.index("to see each scene:") :].splitlines()[1].split(" && ")
    assert [command.split()[1] for command in commands] == ["sheets", "film"]
    monkeypatch.chdir(tmp_path)
    for command in commands:
        # The film is as printed but for its length and size.
        less = ("--until", "0.3", "--width", "320") if " film " in command else ()
        done(run_main(*shlex.split(command)[1:], *less))
    assert len([*(tmp_path / "films").iterdir()]) == 1
    # Then the sheet is there, and is not drawn again.
    assert " sheets " not in done(run_main("failures", *on, "--limit", "1")).out
    recorded = done(run_main("failures", "--model", "log-replay", "--data", town, "--out", out))
    assert recorded.out.startswith("log-replay on small adv (exact, 3 s): no failure in ")


def test_transfer_and_leaderboard(out: Path) -> None:
    assert "surrogate" in done(run_main("transfer", "--out", out)).out
    alone = done(run_main("transfer", "--records", out / "runs" / "small" / "adv" / PLANNERS[0], "--pairs")).out
    assert (
        alone.count("\n") == 1 and " fails " in alone and alone.endswith("eval --data ROOT --split adv --model NAME\n")
    )
    done(run_main("leaderboard", "--out", out))
    page = out / "leaderboard" / "README.md"
    text = page.read_text()
    assert all(name in text for name in (*PLANNERS, "Published numbers, not ours", "UniAD"))
    page.write_text(text.replace("log-replay", "log-reply"))
    stale = run_main("leaderboard", "--out", out, "--check")
    assert (stale.code, stale.out.count("README.md"), stale.out.count("\n")) == (1, 1, 1), stale.out


def test_dry_run_writes_nothing(town: Path, tmp_path: Path) -> None:
    common = ("--data", town, "--split", "adv", "--out", tmp_path, *SMALL)
    run = done(run_main("generate", *common, "--dry-run", "--json"))
    assert run.json["tried"] > 0
    assert bytes_below(tmp_path) == {}


def test_rescoring_marks_what_is_older_and_changes_no_byte_of_what_is_current(
    town: Path, out: Path, tmp_path: Path
) -> None:
    records = tmp_path / "runs"
    for name in PLANNERS:
        (found,) = (path.parent for path in (out / "runs").rglob(f"adv/{name}/run.json"))
        shutil.copytree(found, records / name)

    def rescored() -> dict[str, str]:
        run = done(run_main("rescore", "--data", town, "--out", out, "--records", records, "--json"))
        return {Path(result["directory"]).name: result["says"] for result in run.json}

    # Protocols that a run is not judged by unless it is asked for come in at the first time.
    assert {*rescored().values()} == {"rescored"}
    before = bytes_below(records)
    older = records / "log-replay"
    facts = json.loads((older / "run.json").read_text())
    facts["protocols"]["uniad"] -= 1
    (older / "run.json").write_text(json.dumps(facts))
    notes = [note for table in run_tables("small", [load_record(older)], ["uniad"]) for note in table.notes]
    assert "challenger-bench rescore" in "".join(notes)
    assert rescored() == {"constant-velocity": "current", "log-replay": "rescored"}
    after = bytes_below(records)
    assert {name for name in after if after[name] != before[name]} <= {"log-replay/run.json"}
    assert json.loads((older / "run.json").read_text())["rescored"] is not None


def test_rescoring_with_other_data_is_refused_and_loses_nothing(out: Path, tmp_path: Path) -> None:
    other = tmp_path / "small"
    other_town = ("--town-scenes", "1", "--seed", "5", "--renderer", "none", "--workers", "1")
    done(run_main("data", "build", "--root", other, *other_town))
    before = bytes_below(out / "runs")
    run = run_main("rescore", "--data", other, "--out", out)
    assert run.code == 1
    assert "fingerprint" in run.out
    assert bytes_below(out / "runs") == before


def test_transfer_under_another_protocol_and_its_heat_map(out: Path, tmp_path: Path) -> None:
    run = done(run_main("transfer", "--out", out, "--protocol", "vad-23", "--json"))
    assert run.json["small"]["protocol"] == "vad-23"
    picture = tmp_path / "transfer.png"
    drawn = set()
    for what in ((), ("--figure-of", "adversary")):
        text = done(run_main("transfer", "--out", out, "--figure", picture, *what)).out
        assert "φ" in text and "lift" in text and picture.read_bytes().startswith(b"\x89PNG")
        drawn.add(picture.read_bytes())
    assert len(drawn) == 2
    bare = run_main("transfer", "--out", out, "--protocol", "vad", "--figure", picture, "--figure-of", "adversary")
    assert bare.code == 2 and "name the other party of each contact" in bare.err


def test_driving_scores_are_printed_on_request_and_kept_anyway(town: Path, out: Path) -> None:
    common = ("--model", "constant-velocity", "--data", town, "--split", "adv", "--out", out)
    run = done(run_main("eval", *common, "--protocol", "pdm"))
    assert "nuscenes-pdm (version 2)" in run.out and "collision rate" not in run.out
    assert "nuscenes-pdm" not in done(run_main("eval", *common)).out
    every = done(run_main("eval", *common, "--protocol", "all")).out
    assert "nuscenes-pdm" in every and "protocol vad-23" in every
    (kept,) = done(run_main("eval", *common, "--json")).json
    assert kept["driving"]["counted"] > 0 and 0.0 <= kept["driving"]["columns"]["score"]["mean"]["value"] <= 1.0


def test_further_protocols_judge_on_request_and_whenever_plans_are_judged_anew(town: Path, tmp_path: Path) -> None:
    common = ("--model", "constant-velocity", "--data", town, "--split", "val", "--limit", "1", "--out", tmp_path)
    plain = done(run_main("eval", *common, "--json")).json[0]["protocols"]
    assert set(plain) == {"exact", "uniad", "vad", "vad-23", "sparsedrive", "diffusiondrive"}
    run = done(run_main("eval", *common, "--protocol", "bev-planner", "--protocol", "omnidrive"))
    assert all(text in run.out for text in ("protocol bev-planner", "further rates (%), protocol omnidrive", "kerb"))
    asked = done(run_main("eval", *common, "--json", "--protocol", "omnidrive")).json[0]["protocols"]
    assert set(asked) == {*plain, "omnidrive"} and {name: asked[name] for name in plain} == plain
    assert asked["omnidrive"]["columns"]["off_road"]["3s"]["denominator"] > 0
    says = [done(run_main("rescore", "--data", town, "--out", tmp_path, "--json")).json[0]["says"] for _ in "ab"]
    assert says == ["rescored", "current"]
    (path,) = tmp_path.rglob("summary.json")
    summary = json.loads(path.read_text())["protocols"]
    assert {"stp3", "safemvdrive-box", "opendrivevla", "agent-driver-stp3"} < set(summary)
    assert summary["omnidrive"] == asked["omnidrive"]
