"""Driving a split: kept units, resumed work, any number of processes, scores made anew."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.planners.stop import Stop
from adapters.registry import planner_factory
from benchmark import api
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.engines import make_backend
from benchmark.closed_loop.scoring import VERSION
from benchmark.errors import InputError
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord, load_drives, write_drives
from benchmark.runs.drive_estimate import estimate_driving
from benchmark.runs.driving import DriveSettings, count_cached_units, drive_split, drives_directory, make_job
from benchmark.runs.redriving import redrive_and_score
from benchmark.runs.rescoring_drives import rescore_all_drives, rescore_drives
from benchmark.scene import Scene
from tests.benchmark.cli.cli_runs import bytes_below, refusal
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Factory, Failing, Remembering, Straight

SETTINGS = DriveSettings("default", DefaultBackend())
IDM = replace(SETTINGS, agents="idm", maker=DefaultBackend("idm"))
LATE = replace(SETTINGS, latency_ms=200, maker=DefaultBackend(latency_us=200_000))
WORLDS = [SETTINGS, IDM]
"""Those of extensions are asked the same where their tests are."""


def town() -> FakeData:
    return town_of_two(slow_leader=True)


def driven(out: Path, planner: Any, settings: DriveSettings = SETTINGS, data: FakeData | None = None) -> DriveRecord:
    return drive_split(data or town(), "val", planner, out, settings, reopen=town)


def test_a_split_becomes_a_record(tmp_path: Path) -> None:
    record = driven(tmp_path, Straight())
    assert [row.scene for row in record.rows] == ["scene-9901", "scene-9902"]
    assert [row.end for row in record.rows] == ["end", "contact"]
    assert record.summary.columns["contact"].value == 0.5 and record.facts.runs == 1
    assert load_drives(record.directory) == record
    assert record.directory == tmp_path / "fake" / "val" / "default-replay-none" / "straight"


@dataclass
class Reading(FakeData):
    """Counts how often scenes are read."""

    read: list[str] = field(default_factory=list)

    def scene(self, name: str) -> Scene:
        self.read.append(name)
        return super().scene(name)


def test_finished_units_are_read_and_nothing_is_driven_again(tmp_path: Path) -> None:
    planner, data = Straight(), Reading(town().scenes)
    first = driven(tmp_path, planner, data=data)
    before, calls, read = bytes_below(tmp_path), planner.calls, len(data.read)
    assert driven(tmp_path, planner, data=data) == first
    # Once each, for what the record says of the scenes.
    assert planner.calls == calls and data.read[read:] == sorted(data.scenes) and bytes_below(tmp_path) == before
    driven(tmp_path, planner, replace(SETTINGS, fresh=True))
    assert planner.calls == 2 * calls and bytes_below(tmp_path) == before


def test_whatever_decides_a_drive_is_part_of_its_key(tmp_path: Path) -> None:
    planner = Straight()
    driven(tmp_path, planner)
    calls = planner.calls
    slower = {name: replace(scene, adversaries=scene.agents.ids[:1]) for name, scene in town().scenes.items()}
    other = FakeData({name: replace(scene, agents=moved(scene)) for name, scene in slower.items()})
    driven(tmp_path, planner, data=other)
    assert planner.calls > calls
    for settings in (IDM, LATE):
        calls = planner.calls
        driven(tmp_path, planner, settings)
        assert planner.calls > calls
    assert len(list(tmp_path.rglob("drive.json"))) == 3


def moved(scene: Scene) -> Any:
    return replace(scene.agents, position=scene.agents.position + [0.5, 0.0, 0.0])


def test_a_damaged_or_cut_file_is_driven_again(tmp_path: Path) -> None:
    first = driven(tmp_path, Straight())
    before = bytes_below(tmp_path)
    kept = sorted((first.directory / "drives").iterdir())
    kept[0].write_text(kept[0].read_text()[:-40])
    kept[1].write_bytes(kept[1].read_bytes().replace(b'"end":"contact"', b'"end":"end"'))
    planner = Straight()
    assert driven(tmp_path, planner) == first and planner.calls > 0 and bytes_below(tmp_path) == before


def test_the_order_and_company_of_scenes_change_no_drive(tmp_path: Path) -> None:
    both = driven(tmp_path / "both", Factory(Remembering))
    alone = driven(tmp_path / "alone", Factory(Remembering), replace(SETTINGS, scenes=("scene-9902",)))
    assert alone.rows == both.rows[1:] and alone.directory.name != both.directory.name


def test_a_failed_drive_is_a_row_and_no_score(tmp_path: Path) -> None:
    record = driven(tmp_path, Failing())
    assert record.facts.status == "partial" and record.summary.failed == 2 and record.summary.columns == {}
    assert all(row.failure is not None and "no idea" in row.failure.text for row in record.rows)
    # An address would differ from process to process.
    assert "0x..." in str(record.rows[0].failure)
    again = Failing()
    driven(tmp_path, again)
    assert again.calls == 0


def test_who_was_late_is_asked_again(tmp_path: Path) -> None:
    late = driven(tmp_path, Straight(pause_s=0.2), replace(SETTINGS, timeout_s=0.05))
    assert late.summary.reasons == {"timeout": 2}
    assert driven(tmp_path, Straight()).complete


@pytest.mark.parametrize("settings", WORLDS[:1])
def test_a_scenario_that_draws_nothing_is_driven_once(settings: DriveSettings, tmp_path: Path) -> None:
    record = driven(tmp_path, Straight(), replace(settings, runs=10))
    assert record.facts.runs == 1 and len(record.rows) == 2


@pytest.mark.parametrize("settings", WORLDS)
def test_a_drive_is_repeated_without_its_planner(settings: DriveSettings, tmp_path: Path) -> None:
    data = town()
    record = driven(tmp_path, Remembering(), settings)
    for row in record.rows:
        scene = data.scene(row.scene)
        assert redrive_and_score(settings.maker, scene, data, row) == row


def test_a_drive_is_scored_anew_without_its_planner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    planner = Straight()
    driven(tmp_path, planner)
    calls = planner.calls
    monkeypatch.setattr("benchmark.runs.drive_work.VERSION", VERSION + 1)
    again = driven(tmp_path, planner)
    assert planner.calls == calls and again.rows == driven(tmp_path, planner).rows


@pytest.mark.parametrize("settings", WORLDS)
def test_a_record_is_scored_anew_without_its_planner(settings: DriveSettings, tmp_path: Path) -> None:
    record = driven(tmp_path, Remembering(), settings)
    before = bytes_below(record.directory)
    assert rescore_drives(record.directory, town()) == record and bytes_below(record.directory) == before
    spoil(record)
    again = rescore_drives(record.directory, town())
    assert again.rows == record.rows and again.summary == record.summary
    assert again.facts.rescored is not None and again.content_id == record.content_id
    assert load_drives(record.directory) == again
    after = bytes_below(record.directory)
    assert {name for name in before if before[name] != after[name]} == {"drive.json"}
    rescore_drives(record.directory, town())
    assert bytes_below(record.directory) == after
    with pytest.raises(InputError, match="used other data of"):
        rescore_drives(record.directory, FakeData({"scene-9901": town().scenes["scene-9901"]}))


def test_all_records_of_drives_are_scored_anew_and_one_that_cannot_be_stops_no_other(tmp_path: Path) -> None:
    good, bad, current = (driven(tmp_path, Straight(), each) for each in (SETTINGS, IDM, LATE))
    spoil(good)
    rows = bad.directory / "drives.jsonl"
    rows.write_text(rows.read_text()[:-40])
    said = {each.directory: each for each in rescore_all_drives(tmp_path, lambda split: town(), "fake")}
    assert {each: said[each].failed for each in said} == {
        good.directory: False,
        bad.directory: True,
        current.directory: False,
    }
    assert said[good.directory].sentence == "rescored" and said[current.directory].sentence == "current"
    assert "drives.jsonl" in said[bad.directory].sentence
    others = {each.sentence for each in rescore_all_drives(tmp_path, lambda split: town(), "other") if not each.failed}
    assert others == {"skipped: it belongs to data set fake; choose that one with --data"}
    with pytest.raises(InputError, match="nowhere does not exist"):
        list(rescore_all_drives(tmp_path / "nowhere", lambda split: town(), "fake"))


def spoil(record: DriveRecord) -> None:
    """Write a record in place of this one whose scores are wrong."""
    worse = [row.model_copy(update={"scores": None if row.scores is None else spoilt(row)}) for row in record.rows]
    names = set(type(record.facts).model_fields) - {"schema_version", "status", "seed", "files"}
    write_drives(record.directory, {name: getattr(record.facts, name) for name in names}, worse, seed=0)


def spoilt(row: EpisodeRow) -> Any:
    assert row.scores is not None
    return row.scores.model_copy(update={"progress_m": -1.0})


def test_plans_that_lead_elsewhere_are_refused(tmp_path: Path) -> None:
    row = driven(tmp_path, Straight()).rows[0]
    plans = [plan.model_copy(update={"waypoints": (0.5 * np.array(plan.waypoints)).tolist()}) for plan in row.plans]
    data = town()
    with pytest.raises(InputError, match="give another"):
        redrive_and_score(SETTINGS.maker, data.scene(row.scene), data, row.model_copy(update={"plans": plans}))


def test_kept_drives_of_scenes_that_are_gone_are_removed(tmp_path: Path) -> None:
    record = driven(tmp_path, Straight())
    stray = record.directory / "drives" / "scene-0000-0.json"
    stray.write_text("{}")
    driven(tmp_path, Straight())
    assert not stray.exists()


def test_planners_that_remember_across_scenes_are_refused(tmp_path: Path) -> None:
    class Continuous(Straight):
        memory_crosses_scenes = True

        def begin_run(self) -> None:
            pass

    with pytest.raises(InputError, match="keeps state across scenes"):
        driven(tmp_path, Continuous())


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"runs": 0}, "--runs"),
        ({"runs": 100_000_000}, "at most 10000"),
        ({"scenes": ("scene-1",)}, "no scene"),
        ({"limit": 0}, "--limit"),
        ({"timeout_s": float("inf")}, "--timeout"),
    ],
)
def test_wrong_settings_are_refused(tmp_path: Path, changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        driven(tmp_path, Straight(), replace(SETTINGS, **changes))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("neurocap@code",), "did you mean neuroncap@code"),
        (("default", "iddm"), "did you mean idm"),
        (("neuroncap@code", "idm"), "never react"),
    ],
)
def test_engines_that_there_are_not_are_refused(arguments: tuple[Any, ...], says: str) -> None:
    with pytest.raises(InputError, match=says):
        make_backend(*arguments)


def test_without_anybody_to_make_it_there_is_no_adversary() -> None:
    data = town()
    with pytest.raises(InputError, match="the scene has no adversary"):
        make_backend("default", "adversary").begin(data.scene(data.scene_names("val")[0]), 0, None)  # type: ignore[arg-type]


def test_only_an_adversary_considers_anything() -> None:
    with pytest.raises(InputError, match="--keep-considered"):
        api.drive_settings("val", keep_considered=True)
    assert "--keep-considered" in refusal("drive", "--keep-considered")


def test_an_estimate_counts_what_is_kept_and_keeps_nothing(tmp_path: Path) -> None:
    data, factory = town(), planner_factory("stop")
    said = estimate_driving(data, "val", factory, SETTINGS, tmp_path)
    assert "would drive stop through 2 scenes of val" in said and "at most about 0:0" in said
    assert not list(tmp_path.iterdir())
    drive_split(data, "val", Stop(), tmp_path, SETTINGS)
    # Made by hand it has another identity than the registry's; what the registry makes is kept under its own.
    drive_split(data, "val", factory, tmp_path, SETTINGS)
    assert "2 of them already kept" in estimate_driving(data, "val", factory, SETTINGS, tmp_path)
    job = make_job(data, "val", factory.facts, tmp_path, SETTINGS)
    assert count_cached_units(job, SETTINGS.units(data, ("scene-9901",))) == 1


def test_records_of_different_worlds_have_different_folders() -> None:
    facts = Factory().facts
    places = {
        drives_directory(Path("out"), "fake", "val", facts, settings.measured)
        for settings in (SETTINGS, replace(SETTINGS, engine="neuroncap@paper"), LATE, IDM)
    }
    assert len(places) == 4
