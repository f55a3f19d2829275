"""Records of drives: whole or not there, damaged ones refused, failures never a zero."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmark.closed_loop.scoring import VERSION
from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256
from benchmark.records.drive_schema import SCHEMA, ClosedLoopDefinition, EpisodeRow
from benchmark.records.drives import (
    DriveRecord,
    compute_column_values,
    find_drives,
    load_drives,
    summarise_episodes,
    write_drives,
)
from benchmark.records.run_schema import SceneFacts
from benchmark.records.store import pending_path


def row(scene: str = "scene-1", run: int = 0, **changes: Any) -> EpisodeRow:
    """A drive of two instants, without contact."""
    ego = [[0.0] * 7, [4.0, 0.0, 0.0, 8.0, 0.0, 0.0, 0.0]]
    made = {
        **{"scene": scene, "run": run, "status": "ok", "end": "end", "primed": 1},
        "ticks": {"time_us": [0, 500_000], "ego": ego, "command": [2], "station": [0.0]},
        "plans": [{"frame": "ego", "waypoints": [[4.0, 0.0]] * 6}],
        **{"contact": None, "scores": scores(), "failure": None},
    }
    return EpisodeRow.model_validate({**made, **changes})


def scores(route: float | None = 0.5, **changes: Any) -> dict[str, Any]:
    terms = dict.fromkeys(("score", "nc", "dac", "mp", "ddc", "p", "ttc", "c"), 1.0)
    made = {
        **{"progress_m": 4.0, "recorded_progress_m": 8.0, "route_share": route, "comfortable": 1.0},
        "nuplan": {**terms, "off_road_s": None, "least_ttc_s": None},
        "hd": {"score": 0.5, "plans": 1.0, "completed": 0.5},
        "neuroncap": None,
    }
    return {**made, **changes}


def contact(at_fault: bool = True, verdict: str | None = "") -> dict[str, Any]:
    """Verdicts of both rules are the same but where one is given; ``None`` is an older record's."""
    verdict = ("ego" if at_fault else "other") if verdict == "" else verdict
    return {
        "fault": None if verdict is None else {"verdict": verdict, "reason": "lane-change"},
        **{"seconds": 0.3, "agent": "a", "category": "vehicle.car", "adversary": True, "kind": "front"},
        **{"at_fault": at_fault, "impact_speed": 5.0, "delta_v_ego": 2.5, "delta_v_other": 2.5},
    }


def failed(scene: str = "scene-2", reason: str = "raised") -> EpisodeRow:
    failure = {"reason": reason, "text": "ValueError: no"}
    return row(scene, status="failed", end="failed", scores=None, failure=failure)


def facts(**changes: Any) -> dict[str, Any]:
    made = {
        "planner": {"name": "made", "privileged": False},
        "data": {"name": "fake", "version": "v1", "fingerprint": "f" * 64},
        **{"split": "adv", "scenes": ["scene-1", "scene-2"], "scenes_in_split": 2, "scene_facts": {}},
        "measured": {"engine": "default", "agents": "replay", "sensor": "none"},
        **{"runs": 1, "scoring": VERSION, "config": {}, "environment": {}},
    }
    return {**made, **changes}


def written(folder: Path, *rows: EpisodeRow, **changes: Any) -> DriveRecord:
    return write_drives(folder, facts(**changes), rows or (row(), row("scene-2")), seed=0)


def test_a_record_reads_back(tmp_path: Path) -> None:
    made = written(tmp_path / "a")
    assert load_drives(tmp_path / "a") == made and made.complete and made.covers_split
    assert find_drives(tmp_path) == [made]


@pytest.mark.parametrize("field", ["scoring", "scenes_in_split", "runs"])
def test_a_number_as_text_is_no_number(field: str, tmp_path: Path) -> None:
    written(tmp_path / "a")
    path = tmp_path / "a" / "drive.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), field: "7"}))
    with pytest.raises(InputError, match=f"is damaged .{field}"):
        load_drives(tmp_path / "a")


def test_the_same_record_is_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        written(tmp_path / name)
    one, other = ({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("a", "b"))
    assert one == other and set(one) == {"drive.json", "drives.jsonl", "summary.json"}
    assert load_drives(tmp_path / "a").content_id == load_drives(tmp_path / "b").content_id


def test_a_failed_drive_is_in_no_number(tmp_path: Path) -> None:
    made = written(tmp_path, row("scene-1"), failed("scene-2"))
    assert made.facts.status == "partial" and made.summary.failed == 1 and made.summary.coverage == 0.5
    assert made.summary.reasons == {"raised": 1}
    for name, rate in made.summary.columns.items():
        assert rate.denominator in (0, 1), name
    assert made.summary.columns["contact"].value == 0.0 and made.summary.columns["route"].value == 0.5


def test_of_failed_drives_alone_there_is_no_number(tmp_path: Path) -> None:
    made = written(tmp_path, failed("scene-1", "timeout"), failed("scene-2"))
    assert made.summary.columns == {} and made.summary.reasons == {"raised": 1, "timeout": 1}
    with pytest.raises(AssertionError):
        compute_column_values(failed())


def test_what_says_nothing_is_no_zero() -> None:
    hit = row("scene-1", end="contact", contact=contact())
    summary = summarise_episodes([hit, row("scene-2", scores=scores(route=None))], {}, seed=0)
    assert summary.columns["impact_speed"].value == 5.0 and summary.columns["impact_speed"].denominator == 1
    careful = {"cc": {"survives": True}}
    blameless = compute_column_values(row(end="contact", contact=contact(at_fault=False), ladder=careful))
    assert blameless["attributable"] == blameless["bystander"] == 0.0
    older = compute_column_values(row(end="contact", contact=contact(verdict=None), ladder=careful))
    assert older["attributable"] is older["at_fault"] is None and older["at_fault_nuplan"] == older["contact"] == 1.0
    assert summary.columns["contact"].value == 0.5 and summary.columns["route"].denominator == 1


def test_whose_fault_contacts_are_is_a_column_each() -> None:
    verdicts = ("ego", "other", "shared", "unclear")
    hits = [row(f"scene-{name}", end="contact", contact=contact(verdict=name)) for name in verdicts]
    columns = summarise_episodes([*hits, row("scene-2")], {}, seed=0).columns
    assert [columns[name].value for name in ("at_fault", "shared_fault", "unclear_fault")] == [0.2, 0.2, 0.2]
    assert columns["at_fault_nuplan"].value == 0.8
    # Where one does not say it, a rate of the rest would be wrong.
    older = [*hits, row("scene-3", end="contact", contact=contact(verdict=None))]
    columns = summarise_episodes(older, {}, seed=0).columns
    assert columns["at_fault"].value is columns["shared_fault"].value is None
    assert columns["at_fault_nuplan"].value == columns["contact"].value == 1.0


def test_intervals_draw_recordings_and_not_what_was_made_from_them() -> None:
    rows = [row(f"scene-{number}", end="contact", contact=contact()) for number in range(6)] + [row("scene-6")]
    apart = summarise_episodes(rows, {}, seed=0).columns["contact"]
    one = {each.scene: SceneFacts(source="recorded") for each in rows}
    together = summarise_episodes(rows, one, seed=0).columns["contact"]
    assert apart.low is not None and together.low is None and apart.value == together.value


def test_numbers_of_two_engines_have_no_column_in_common_but_the_road() -> None:
    own = {"score": 3.0, "impact_speed": 2.0, "reference_speed": 8.0}
    ncap = compute_column_values(row(scores=scores(nuplan=None, hd=None, neuroncap=own)))
    assert ncap["nns"] == 3.0 and "contact" not in ncap
    common = {"impact_speed", "route", "progress_m", "comfortable", "seconds"}
    assert set(ncap) & set(compute_column_values(row())) == common


@pytest.mark.parametrize(
    "changes",
    [
        {"status": "failed"}, {"scores": None}, {"end": "contact"}, {"contact": contact()},
        {"failure": {"reason": "raised", "text": "no"}}, {"failure": {"reason": "bored", "text": "no"}},
        {"ticks": {"time_us": [0], "ego": [], "command": [], "station": []}}, {"scores": scores(route=1.5)},
        {"scores": scores(comfortable=float("nan"))}, {"unknown": 1},
    ],
)  # fmt: skip
def test_rows_that_cannot_be_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        row(**changes)


def test_damage_is_one_sentence(tmp_path: Path) -> None:
    written(tmp_path)
    path = tmp_path / "drives.jsonl"
    path.write_text(path.read_text().replace("scene-2", "scene-3"))
    with pytest.raises(InputError, match="does not belong") as refused:
        load_drives(tmp_path)
    assert "\n" not in str(refused.value)
    head = json.loads((tmp_path / "drive.json").read_text())
    for change, says in (
        ({"schema": SCHEMA + 1}, "upgrade"),
        ({"files": None}, "no record of drives"),
        ({"runs": 0, "files": hashes(tmp_path)}, "runs"),
    ):
        (tmp_path / "drive.json").write_text(json.dumps({**head, **change}))
        with pytest.raises(InputError, match=says):
            load_drives(tmp_path)


def hashes(folder: Path) -> dict[str, str]:
    return {name: file_sha256(folder / name) for name in ("drives.jsonl", "summary.json")}


def test_an_interrupted_replacement_leaves_a_whole_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = written(tmp_path)
    monkeypatch.setattr("benchmark.records.store._rename", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        written(tmp_path, row("scene-1", end="contact", contact=contact()), row("scene-2"))
    monkeypatch.undo()
    assert load_drives(tmp_path) == before and pending_path(tmp_path, "drive.json").exists()
    again = written(tmp_path, row("scene-1", end="contact", contact=contact()), row("scene-2"))
    assert load_drives(tmp_path) == again and not list(tmp_path.glob(".*"))


def test_nothing_is_written_without_drives(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no drive"):
        write_drives(tmp_path, facts(), [], seed=0)
    with pytest.raises(InputError, match="nowhere does not exist"):
        find_drives(tmp_path / "nowhere")


def test_what_was_measured_is_part_of_the_name() -> None:
    for engine, agents, latency_ms, world in (
        ("default", "idm", 200, "default, agents idm, latency 200 ms"),
        ("neuroncap@code", "replay", 0, "neuroncap@code"),
    ):
        said = {"engine": engine, "agents": agents, "sensor": "none", "latency_ms": latency_ms}
        assert ClosedLoopDefinition.model_validate(said).world == world
