"""Drives against an adversary that answers: records, resumption, workers, the ladder beside them, and driving again."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from adapters.registry import planner_factory
from benchmark import api
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.engines import restore_backend
from benchmark.errors import InputError
from benchmark.extensions.submissions.recomputed import recompute_drives
from benchmark.machine.workers import LocalProcesses
from benchmark.metrics.rates import Rate
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.search_trace import read_search_trace
from benchmark.runs import drive_work
from benchmark.runs import drive_work as ladders
from benchmark.runs.driving import DriveSettings, drive_planners
from benchmark.runs.redriving import redrive_and_score, repeat_search
from generation.extensions.reactive_adversary.settings import EgoPrediction
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.generation.extensions.reactive_adversary.loops import SETTINGS, rides

ADVERSARY = DriveSettings("default", rides(), agents="adversary", ladder=("recorded", "cc"), runs=2, together=4)
PLANNERS = [planner_factory(name) for name in ("constant-velocity", "stop")]


def town() -> FakeData:
    return town_of_two(slow_leader=True)


def driven(out: Path, settings: DriveSettings = ADVERSARY, planners: Any = PLANNERS) -> list[DriveRecord]:
    return drive_planners(town(), "val", planners, out, settings, reopen=town)


@pytest.mark.path
def test_a_planner_is_driven_against_an_adversary_that_answers(tmp_path: Path) -> None:
    (record,) = driven(tmp_path, replace(ADVERSARY, runs=1, ladder=("cc",)), PLANNERS[:1])
    assert len(record.rows) == 2 and load_drives(record.directory).rows == record.rows
    for row in record.rows:
        assert row.adversary is not None and row.adversary.replanned[0] == row.adversary.start >= 12
        assert row.ladder is not None and set(row.ladder) == {"cc"}


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> list[DriveRecord]:
    return driven(tmp_path_factory.mktemp("adversary"))


def test_what_the_adversary_depends_on_is_part_of_what_was_measured(records: list[DriveRecord], tmp_path: Path) -> None:
    measured = records[0].facts.measured
    assert measured.agents_facts["knows"] == "motion"
    assert "knows motion" in measured.world
    assert "candidates 24" in measured.world
    other = replace(ADVERSARY, maker=rides(replace(SETTINGS, knows=EgoPrediction.NOTHING)), runs=1, ladder=("cc",))
    (found,) = driven(tmp_path, other, PLANNERS[:1])
    assert found.facts.measured.world != measured.world
    assert found.directory.parent.name != records[0].directory.parent.name
    # What has no adversary is written as it always was.
    (plain,) = driven(tmp_path, DriveSettings("default", DefaultBackend()), PLANNERS[:1])
    assert "agents_facts" not in plain.facts.measured.model_dump(mode="json")
    assert not {"adversary", "ladder"} & set(plain.rows[0].model_dump(mode="json"))


def test_every_drive_says_where_the_adversary_went_and_whom_the_encounter_is_fair_to(
    records: list[DriveRecord],
) -> None:
    for record in records:
        assert len(record.rows) == 4
        for row in record.rows:
            assert row.adversary is not None
            assert row.adversary.replanned[0] == row.adversary.start >= 12
            assert row.ladder is not None
            assert set(row.ladder) == {"recorded", "cc"}
        survives = sum(bool(row.fair) for row in record.rows) / 4
        assert record.summary.columns["survives_cc"].value == survives
        blamed = [row.contact for row in record.rows if row.fair and row.contact is not None and row.contact.at_fault]
        pursued = sum(contact.adversary for contact in blamed)
        assert record.summary.columns["attributable"].value == pursued / 4
        assert record.summary.columns["bystander"].value == (len(blamed) - pursued) / 4
    ladders_of = [[row.ladder for row in record.rows] for record in records]
    assert ladders_of[0] == ladders_of[1]
    assert load_drives(records[0].directory).rows == records[0].rows


def test_a_submission_whose_summary_counted_bystanders_is_fit_and_a_wrong_count_is_found(
    records: list[DriveRecord],
) -> None:
    def with_columns(**columns: Rate) -> DriveRecord:
        return replace(records[0], summary=records[0].summary.model_copy(update={"columns": columns}))

    found = dict(records[0].summary.columns)
    new = ("bystander", "shared_fault", "unclear_fault", "at_fault_nuplan")
    without = {name: rate for name, rate in found.items() if name not in new}
    old = with_columns(**{**without, "attributable": found["at_fault"]})
    flattering = with_columns(**{**found, "attributable": replace(found["at_fault"], value=0.125)})
    assert list(recompute_drives(old, town())) == []
    ((_, said),) = recompute_drives(flattering, town())
    assert "claims attributable = 0.125" in said


def test_processes_and_stopping_half_way_change_no_byte(records: list[DriveRecord], tmp_path: Path) -> None:
    expected = bytes_below(records[0].directory.parents[3])
    driven(tmp_path / "two", replace(ADVERSARY, executor=LocalProcesses(2), together=1))
    assert bytes_below(tmp_path / "two") == expected
    out = tmp_path / "stopped"
    driven(out, planners=PLANNERS[:1])
    for path in [*out.rglob("drive.json"), *out.rglob("drives.jsonl"), *out.rglob("summary.json")]:
        path.unlink()
    next(path for path in out.rglob("drives/*.json")).write_text("{")
    next(path for path in out.rglob("ladder/*.json")).unlink()
    driven(out)
    assert bytes_below(out) == expected


def test_kept_ladders_are_not_climbed_again(
    records: list[DriveRecord], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driven(tmp_path, planners=PLANNERS[:1])

    def climbed(*_: Any) -> None:
        raise AssertionError("climbed again")

    monkeypatch.setattr(ladders, "simulate_reference_drivers", climbed)
    assert [row.ladder for row in driven(tmp_path)[1].rows] == [row.ladder for row in records[1].rows]


def test_a_drive_is_repeated_without_any_search(records: list[DriveRecord], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("generation.extensions.reactive_adversary.policy.run_searches", None)
    data = town()
    maker = restore_backend(records[0].facts.measured)
    for row in [row for record in records for row in record.rows]:
        assert redrive_and_score(maker, data.scene(row.scene), data, row) == row


def test_tracks_of_one_planner_are_driven_against_another(records: list[DriveRecord], tmp_path: Path) -> None:
    source = records[0]
    settings = api.drive_settings("val", agents="adversary", adversary_tracks=source.directory, ladder=["cc"])
    assert settings.runs_made == 2
    (found,) = driven(tmp_path, settings, PLANNERS[1:])
    assert found.facts.measured.agents_facts == {
        "tracks_of": source.planner, "record": source.content_id, "others": "replay",
    }  # fmt: skip
    for ours, theirs in zip(found.rows, source.rows, strict=True):
        assert ours.adversary is not None and theirs.adversary is not None
        assert (ours.adversary.start, ours.adversary.poses) == (theirs.adversary.start, theirs.adversary.poses)
    with pytest.raises(InputError, match="does not hold"):
        api.drive_settings("adv", agents="adversary", adversary_tracks=source.directory)
    with pytest.raises(InputError, match="add --agents adversary"):
        api.drive_settings("val", adversary_tracks=source.directory)
    with pytest.raises(InputError, match="--keep-considered"):
        api.drive_settings("val", keep_considered=True, agents="adversary", adversary_tracks=source.directory)


KEEPING = replace(ADVERSARY, maker=rides(replace(SETTINGS, keep_considered=True)), keep_considered=True)


def beside(out: Path) -> dict[str, bytes]:
    return {name: content for name, content in bytes_below(out).items() if "considered" in Path(name).parts}


def test_what_was_considered_is_kept_beside_a_record_of_the_same_bytes(
    records: list[DriveRecord], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = driven(tmp_path / "fresh", KEEPING)
    fresh = bytes_below(tmp_path / "fresh")
    kept = beside(tmp_path / "fresh")
    plain = bytes_below(records[0].directory.parents[3])
    assert len(kept) == 8 and {name: fresh[name] for name in fresh.keys() - kept.keys()} == plain
    for record in found:
        for row in record.rows:
            frames = read_search_trace(record.directory, row)
            assert frames is not None and row.adversary is not None
            assert [each.frame for each in frames] == row.adversary.replanned
            assert [each.did != "searched" for each in frames] == [score is None for score in row.adversary.scores]
    # Of drives that are kept, the search is repeated, and nobody drives.
    later = tmp_path / "later"
    driven(later)
    assert not beside(later)
    monkeypatch.setattr(drive_work, "_run_episodes", None)
    driven(later, KEEPING)
    assert beside(later) == kept
    # What was there stays; what is damaged is made anew.
    monkeypatch.setattr(drive_work, "repeat_search", None)
    driven(later, KEEPING)
    next(later.rglob("considered/*.json")).write_text("{")
    with pytest.raises(TypeError):
        driven(later, KEEPING)


def test_an_adversary_that_would_go_elsewhere_is_not_shown(records: list[DriveRecord]) -> None:
    row = records[0].rows[0]
    assert row.adversary is not None
    moved = [[x, y + 0.001, yaw] for x, y, yaw in row.adversary.poses]
    elsewhere = row.model_copy(update={"adversary": row.adversary.model_copy(update={"poses": moved})})
    data = town()
    with pytest.raises(InputError, match="give another"):
        repeat_search(rides(), data.scene(row.scene), data, elsewhere)
