"""Drives that end at the ego's fault alone: whoever touches it otherwise goes, and everything else is as it was."""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.engines import make_backend, restore_backend
from benchmark.closed_loop.episodes import Episode, run_episode, run_episodes
from benchmark.closed_loop.scoring import EpisodeScores, score_episode
from benchmark.errors import InputError
from benchmark.planning import Planner
from benchmark.records.drive_schema import ClosedLoopDefinition, EpisodeRow, ScoredContact
from benchmark.records.drives import compute_column_values, load_drives
from benchmark.records.fault import blames_ego
from benchmark.runs.drive_rows import build_episode_row
from benchmark.runs.driving import DriveSettings, drive_split
from benchmark.runs.redriving import redrive_and_score
from benchmark.scene import Scene
from tests.benchmark.closed_loop.staged import Peeking, Watching, staged
from tests.benchmark.fake_data import FakeData
from tests.hand_made import Car, scene_on_straight_road

FAULT = DefaultBackend(until="fault@1")
BY_NUPLAN = DefaultBackend(until="fault@nuplan")
BEHIND = Car(20.0, 198.25, 12.0)
"""Runs into whoever is slower."""
STANDING = Car(110.0, 198.25, 0.0)


def road(*cars: Car, seconds: float = 12.0) -> Scene:
    return scene_on_straight_road(cars, ego_speed=8.0, seconds=seconds)


def driven(scene: Scene, planner: Planner, maker: DefaultBackend = FAULT) -> tuple[Episode, EpisodeScores]:
    found = run_episode(staged(scene, maker), planner)
    return found, score_episode(scene, found)


def test_whoever_runs_into_the_ego_goes_and_the_drive_goes_on() -> None:
    scene = road(BEHIND)
    ended, before = driven(scene, Watching(speed=6.0), DefaultBackend())
    found, scores = driven(scene, Watching(speed=6.0))
    assert before.contact is not None and scores.passed == (before.contact,) and scores.contact is None
    assert found.end == "end" and found.touch is None and not before.contact.at_fault
    shared = len(ended.motion.times_us)
    assert np.array_equal(found.motion.ego[:shared], ended.motion.ego)
    (touch,) = found.passed
    there = found.motion.times_us[found.motion.present[0]]
    # It is there up to the planning instant after the contact, at which it is not.
    assert touch.time_us < there.max() + 500_000 and there.max() < touch.time_us + 500_000
    assert not found.motion.present[0, np.searchsorted(found.motion.times_us, touch.time_us + 500_000) :].any()
    assert scores.nuplan is not None and scores.nuplan.nc == 1.0 and scores.nuplan.ttc == 1.0
    assert found.motion.times_us[-1] == scene.timestamps_us[scene.keyframes[-1]]


def test_planners_see_nobody_who_is_gone() -> None:
    planner = Peeking(speed=6.0)
    found, _ = driven(road(BEHIND), planner)
    gone_us = found.passed[0].time_us
    for at, shown in zip(found.motion.times_us[found.motion.ticks[: len(planner.revealed)]], planner.revealed):
        frame = int(np.searchsorted(shown.timestamps_us, at))
        assert bool(shown.agents.valid[0, frame]) is bool(at < gone_us)


def test_ones_own_fault_ends_the_drive_whoever_came_before() -> None:
    found, scores = driven(road(BEHIND, STANDING, seconds=16.0), Watching(speed=6.0))
    assert [each.kind for each in scores.passed] == ["rear"]
    assert found.end == "contact" and scores.contact is not None and blames_ego(scores.contact.fault)
    assert scores.contact.kind == "stopped_track" and scores.contact.seconds > scores.passed[0].seconds
    assert scores.nuplan is not None and scores.nuplan.nc == 0.0


def test_of_two_at_once_the_fault_counts() -> None:
    # Both reach the ego's ends in the same twentieth of a second.
    scene = road(Car(58.0 - 0.910 - 2.3 - 6.0 * 4.0, 198.25, 12.0), Car(58.0 + 3.432 + 2.3 + 6.0 * 4.0, 198.25, 0.0))
    _, scores = driven(scene, Watching(speed=6.0))
    assert scores.contact is not None and blames_ego(scores.contact.fault)
    assert not any(blames_ego(each.fault) for each in scores.passed)


@settings(max_examples=4, deadline=None)
@given(x=st.floats(20.0, 140.0), y=st.floats(193.0, 203.0), speed=st.floats(0.0, 14.0), left=st.floats(-0.6, 0.6))
def test_the_engine_blames_as_the_scores_do(x: float, y: float, speed: float, left: float) -> None:
    scene = road(Car(x, y, speed))
    ended, before = driven(scene, Watching(speed=7.0, left=left), DefaultBackend())
    rules: dict[DefaultBackend, Callable[[ScoredContact], bool | None]] = {
        FAULT: lambda each: blames_ego(each.fault),
        BY_NUPLAN: lambda each: each.at_fault,
    }
    for maker, blames in rules.items():
        found, scores = driven(scene, Watching(speed=7.0, left=left), maker)
        assert not any(blames(each) for each in scores.passed)
        assert scores.contact is None or blames(scores.contact)
        first = scores.passed[0] if scores.passed else scores.contact
        assert first == before.contact
        if before.contact is None or blames(before.contact):
            assert found.end == ended.end and np.array_equal(found.motion.ego, ended.motion.ego)


def test_the_row_says_both_and_drives_again_to_the_same() -> None:
    scene = road(BEHIND, STANDING, seconds=16.0)
    stage = staged(scene, FAULT)
    found = run_episode(stage, Watching(speed=6.0))
    row = build_episode_row(stage, found, score_episode(scene, found))
    assert EpisodeRow.model_validate_json(row.model_dump_json()) == row
    assert row.first_contact == row.passed[0] and row.contact is not None
    values = compute_column_values(row)
    assert values["contact"] == values["at_fault"] == 1.0 and values["impact_speed"] == row.passed[0].impact_speed
    assert redrive_and_score(FAULT, scene, FakeData({scene.name: scene}), row) == row
    with pytest.raises(InputError, match="give another"):
        redrive_and_score(DefaultBackend(), scene, FakeData({scene.name: scene}), row)
    blamed = {**asdict(row.passed[0]), "at_fault": True, "fault": {"verdict": "ego", "reason": "rear-end"}}
    with pytest.raises(ValueError, match="ends a drive"):
        EpisodeRow.model_validate({**row.model_dump(), "passed": [blamed]})


def test_records_say_what_ended_their_drives_and_lie_apart(tmp_path: Path) -> None:
    data = FakeData({"scene-9901": road(BEHIND)})
    records = {}
    for until in ("contact", "fault@1"):
        how = DriveSettings("default", make_backend("default", until=until))
        records[until] = drive_split(data, "val", Watching(speed=6.0), tmp_path, how)
    assert records["contact"].directory != records["fault@1"].directory
    assert records["fault@1"].facts.measured.world.endswith(", until fault@1")
    assert "until" not in (records["contact"].directory / "drive.json").read_text()
    assert "passed" not in (records["contact"].directory / "drives.jsonl").read_text()
    again = load_drives(records["fault@1"].directory)
    assert again == records["fault@1"] and restore_backend(again.facts.measured) == FAULT
    assert again.rows[0].end == "end" and records["contact"].rows[0].end == "contact"


@pytest.mark.parametrize("maker", [FAULT, BY_NUPLAN])
def test_plans_ten_times_a_second_end_by_the_same_rule(maker: DefaultBackend) -> None:
    scene = road(BEHIND, STANDING, seconds=16.0)
    stage = replace(staged(scene, maker), plan_hz=10)
    found = run_episode(stage, Watching(speed=6.0))
    scores = score_episode(scene, found)
    assert [each.kind for each in scores.passed] == ["rear"]
    assert scores.contact is not None and scores.contact.kind == "stopped_track" and scores.contact.at_fault
    (touch,) = found.passed
    assert not found.motion.present[0, found.motion.times_us >= touch.time_us + 100_000].any()
    row = build_episode_row(stage, found, scores)
    assert redrive_and_score(maker, scene, FakeData({scene.name: scene}), row) == row


def test_what_there_is_not_is_refused() -> None:
    with pytest.raises(InputError, match="unknown --until 'faults'; did you mean fault"):
        make_backend("default", until="faults")
    with pytest.raises(InputError, match="every collision ends a run"):
        make_backend("neuroncap@code", until="fault")
    said = ClosedLoopDefinition(engine="default", agents="replay", sensor="none", until="fault@1")
    assert restore_backend(said) == FAULT
    older = said.model_copy(update={"until": "fault"})
    assert restore_backend(older) == BY_NUPLAN and older.world.endswith(", until fault@nuplan")


def test_many_together_are_each_as_alone() -> None:
    scenes = [replace(road(BEHIND), name=f"scene-{number}") for number in range(2)]
    makers = [Watching(speed=speed) for speed in (5.0, 8.0)]
    together = dict(run_episodes([staged(scene, FAULT) for scene in scenes], makers))
    for place, (scene, planner) in enumerate(zip(scenes, makers, strict=True)):
        alone = run_episode(staged(scene, FAULT), planner)
        assert together[place].passed and alone.motion.ego.tobytes() == together[place].motion.ego.tobytes()
        assert alone.motion.present.tobytes() == together[place].motion.present.tobytes()
