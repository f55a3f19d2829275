"""Tables of drives: never two worlds in one, failures and privileged planners marked."""

import json
from pathlib import Path

import pytest

from benchmark.errors import InputError
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord, load_drives
from leaderboard.tables.drives import describe_failures, drive_tables
from tests.benchmark.records.test_drives import contact, failed, row, scores, written

OWN = {"score": 2.0, "impact_speed": 3.0, "reference_speed": 6.0}


def records(folder: Path) -> list[DriveRecord]:
    """Two planners of the default engine, one of them with IDM agents too, and one in NeuroNCAP's."""
    hit = row("scene-1", end="contact", contact=contact())
    ncap = row("scene-1", end="contact", contact=contact(), scores=scores(nuplan=None, hd=None, neuroncap=OWN))
    free = row("scene-2", scores=scores(nuplan=None, hd=None, neuroncap={**OWN, "score": 5.0, "impact_speed": 0.0}))
    seeing = {"name": "seeing", "privileged": True}
    return [
        written(folder / "a", hit, row("scene-2")),
        written(folder / "b", row("scene-1"), failed("scene-2"), planner=seeing),
        written(folder / "c", hit, row("scene-2"), measured={"engine": "default", "agents": "idm", "sensor": "none"}),
        written(
            folder / "d", ncap, free, measured={"engine": "neuroncap@code", "agents": "replay", "sensor": "schematic"}
        ),
    ]


def test_no_two_worlds_share_a_table(tmp_path: Path) -> None:
    found = drive_tables(records(tmp_path))
    assert [table.title for table in found] == [
        "fake adv: closed loop, engine default, agents idm",
        "fake adv: closed loop, engine default, agents replay",
        "fake adv: closed loop, engine neuroncap@code, sensor schematic",
    ]
    assert [table.name for table in found] == [
        "drives-adv-default-idm",
        "drives-adv-default-replay",
        "drives-adv-neuroncap-code-schematic",
    ]
    assert "NNS" in found[2].columns and "NNS" not in found[0].columns and "nuPlan terms" not in found[2].columns


def test_numbers_are_those_of_the_record(tmp_path: Path) -> None:
    _, replay, ncap = drive_tables(records(tmp_path))
    cells = dict(zip(replay.columns, replay.rows[0]))
    assert cells["planner"] == "made" and cells["contact %"] == "50.0" and cells["at fault %"] == "50.0"
    assert cells["impact m/s"] == "5.00" and cells["drives"] == "2" and cells["failed"] == "0"
    shown = dict(zip(ncap.columns, ncap.rows[0]))
    assert shown["NNS"] == "3.50" and shown["CR %"] == "50.0" and shown["sensor"] == "schematic"


def test_failures_stand_apart_and_privileged_planners_last(tmp_path: Path) -> None:
    _, replay, _ = drive_tables(records(tmp_path))
    assert [each[0] for each in replay.rows] == ["made", "seeing †"]
    cells = dict(zip(replay.columns, replay.rows[1]))
    assert cells["failed"] == "1" and cells["contact %"] == "0.0" and cells["impact m/s"] == "–"
    notes = " ".join(replay.notes)
    assert "privileged: sees boxes" in notes and "not HUGSIM" in notes and "too narrow" in notes
    said = describe_failures(records(tmp_path / "again")[1])
    assert said == "seeing failed in 1 of 2 drives (1 raised; the first, scene-2: ValueError: no)"
    (table,) = drive_tables([written(tmp_path / "none", failed("scene-1"), failed("scene-2"))])
    cells = dict(zip(table.columns, table.rows[0]))
    assert cells["contact %"] == "–" and cells["nuPlan terms"] == "–" and cells["failed"] == "2"


def test_other_scenes_are_another_table(tmp_path: Path) -> None:
    one = written(tmp_path / "a", row("scene-1"), row("scene-2"))
    other, again = (written(tmp_path / name, row(name), scenes=[name]) for name in ("scene-1", "scene-2"))
    found, name = drive_tables([again, one, other]), "drives-adv-default-replay"
    assert [table.name for table in found] == [name, f"{name}-part", f"{name}-part-2"]
    assert "1 of 2 scenes of the split" in found[1].title and drive_tables([one, again, other]) == found


def test_other_data_and_latency_are_other_tables(tmp_path: Path) -> None:
    late = {"engine": "default", "agents": "replay", "sensor": "none", "latency_ms": 200}
    changed = {"name": "fake", "version": "v1", "fingerprint": "e" * 64}
    made = written(tmp_path / "a"), written(tmp_path / "b", measured=late), written(tmp_path / "c", data=changed)
    name = "drives-adv-default-replay"
    assert sorted(table.name for table in drive_tables(made)) == [name, f"{name}-2", f"{name}-200ms"]


def test_planners_that_look_at_nothing_stand_beside_every_sensor(tmp_path: Path) -> None:
    def seeing(name: str, sensor: str, **facts: int) -> DriveRecord:
        measured = {"engine": "default", "agents": "replay", "sensor": sensor, "sensor_facts": facts}
        folder = tmp_path / f"{name}-{sensor}-{facts}"
        return written(folder, measured=measured, planner={"name": name, "privileged": False})

    blind, both = seeing("blind", "none"), (seeing("both", "none"), seeing("both", "schematic", width=448))
    found = drive_tables([blind, *both, seeing("fine", "schematic", width=1600)])
    assert sorted([row[:2] for row in table.rows] for table in found) == [
        [("blind", "none"), ("both", "none"), ("fine", "schematic")],
        [("blind", "none"), ("both", "schematic")],
    ]
    notes = sorted(note for table in found for note in table.notes if note.startswith("Sensor"))
    assert notes == ["Sensor schematic: width 1600.", "Sensor schematic: width 448."]


def test_versions_of_a_planner_are_told_apart_and_the_same_twice_is_refused(tmp_path: Path) -> None:
    def seeded(folder: str, seed: int) -> DriveRecord:
        return written(tmp_path / folder, planner={"name": "made", "privileged": False, "seed": seed})

    (table,) = drive_tables([seeded("a", 1), seeded("b", 2)])
    assert [each[0] for each in table.rows] == ["made (seed 1)", "made (seed 2)"]
    with pytest.raises(InputError, match="both hold drives of made"):
        drive_tables([seeded("a", 1), seeded("c", 1)])


def test_a_terminal_shows_less_and_old_scores_are_marked(tmp_path: Path) -> None:
    _, replay, _ = drive_tables(records(tmp_path))
    assert "adversary %" not in replay.plain() and "contact %" in replay.plain()
    for text in (replay.plain(wide=True), replay.markdown(), replay.csv(), json.dumps(replay.as_json())):
        assert "adversary %" in text
    assert replay.latex()
    (table,) = drive_tables([written(tmp_path / "old", scoring=999)])
    assert table.rows[0][0] == "made ‡" and any("version 999" in note for note in table.notes)


def test_neuroncaps_own_averages_stand_beside_ours_under_their_own_name(tmp_path: Path) -> None:
    def run(scene: str, number: int, family: str, score: float | None) -> EpisodeRow:
        own = scores(nuplan=None, hd=None, neuroncap={**OWN, "score": score})
        hit = {} if score == 5.0 else {"end": "contact", "contact": contact()}
        return row(scene, number, family=family, scores=own, **hit)

    rows = (
        *(run("scene-1", number, "frontal", score) for number, score in enumerate((1.0, 1.0, 0.0005))),
        *(run("scene-2", number, "frontal", score) for number, score in enumerate((5.0, 5.0, 5.0))),
        *(run("scene-1", number, "side", score) for number, score in enumerate((5.0, 2.0, None))),
        *(run("scene-2", number, "side", score) for number, score in enumerate((1.0, 5.0, 5.0))),
    )
    measured = {"engine": "neuroncap@code", "agents": "replay", "sensor": "none", "scenarios": "own"}
    record = written(tmp_path / "a", *rows, measured=measured, runs=3)
    published = record.summary.published
    # Scenes: 0.667 and 5, and NaN, which drops out, and 3.667; families 2.834 (half to even of 2.8335) and 3.667.
    assert published is not None and published.nns_by_family == {"frontal": 2.834, "side": 3.667}
    assert published.nns == 3.25 and published.collision == pytest.approx(0.5)
    (table,) = drive_tables([record])
    cells = dict(zip(table.columns, table.rows[0]))
    assert cells["NNS as published code rounds"] == "3.250" and cells["CR % as published code rounds"] == "50.0"
    assert cells["NNS"] != "3.25" and any("rounded to three digits" in note for note in table.notes)
    assert load_drives(record.directory) == record


def test_only_neuroncaps_scenarios_as_code_have_its_averages(tmp_path: Path) -> None:
    for engine, family in (("neuroncap@paper", "side"), ("neuroncap@code", "")):
        own = scores(nuplan=None, hd=None, neuroncap=OWN)
        measured = {"engine": engine, "agents": "replay", "sensor": "none"}
        record = written(tmp_path / engine, row("scene-1", family=family, scores=own), measured=measured)
        assert record.summary.published is None
        (table,) = drive_tables([record])
        assert not any("published" in head for head in table.columns)
