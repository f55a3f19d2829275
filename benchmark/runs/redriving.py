"""Drives driven again by their stored plans, and scored anew: no planner is asked."""

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.closed_loop.adversary import AdversaryTrack, ScriptedTracks
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import Episode, EpisodeSpec, run_episode
from benchmark.closed_loop.observation_builder import NoSensor, Sensor
from benchmark.closed_loop.scoring import score_episode
from benchmark.closed_loop.simulation_state import RecordedCan, SimulatorBackend
from benchmark.errors import InputError
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.records.drive_schema import AdversaryRow, EpisodeRow, ScoredContact
from benchmark.runs.drive_rows import DECIMALS, build_episode_row, decode_adversary_track, encode_adversary_track
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_LONG_S: Final = 3600.0
"""Nothing that is stored is late."""


def read_recorded_can(data: "DataSet", name: str) -> RecordedCan:
    """Measurements of the recorded car in a scene."""
    return RecordedCan.of((observation.ego for observation in data.observations(name)), data.root)


def redrive_and_score(maker: SimulatorBackend, scene: Scene, data: "DataSet", row: EpisodeRow) -> EpisodeRow:
    """Drive the stored plans of a drive and score it anew, without its planner; a failed one has no scores and stays.

    Plans that lead elsewhere than they did are refused.
    """
    if row.status == "failed":
        return row
    stage = _make_episode_spec(maker, NoSensor(), scene, data, row)
    episode = redrive(stage, row, StoredPlans(row))
    rescored_row = build_episode_row(
        stage, episode, None if episode.failure is not None else score_episode(scene, episode)
    )
    kept = {"ladder": row.ladder, "notes": row.notes, "terminated": row.terminated}
    rescored_row = rescored_row.model_copy(update=kept)
    if (rescored_row.ticks, _without_fault(rescored_row)) != (row.ticks, _without_fault(row)):
        raise InputError(_format_mismatch(row))
    return rescored_row


def _without_fault(row: EpisodeRow) -> list[ScoredContact]:
    """Contacts as they happened: whose fault they are is scored anew."""
    return [replace(touch, fault=None) for touch in row.touches]


def _make_episode_spec(
    maker: SimulatorBackend, sensor: Sensor, scene: Scene, data: "DataSet", row: EpisodeRow
) -> EpisodeSpec:
    return EpisodeSpec(
        scene, read_recorded_can(data, row.scene), row.run, _with_its_adversary(maker, row), sensor, _LONG_S, row.family
    )


def _with_its_adversary(maker: SimulatorBackend, row: EpisodeRow) -> SimulatorBackend:
    """A maker whose adversary drives its stored track again, without a search, in the window of the row."""
    if row.window is not None and isinstance(maker, DefaultBackend):
        return replace(maker, window=row.window)
    track = decode_adversary_track(row)
    if track is None or not isinstance(maker, DefaultBackend) or maker.adversary is None:
        return maker
    return replace(maker, adversary=ScriptedTracks({(row.scene, row.run): track}, maker.adversary.others))


def redrive_with_sensor(
    maker: SimulatorBackend, sensor: Sensor, scene: Scene, data: "DataSet", row: EpisodeRow, plans: "StoredPlans"
) -> Episode:
    """A stored drive with all objects in it, from its plans; one in which the planner failed ends where it did.

    Plans that lead elsewhere than they did are refused.
    """
    return redrive(_make_episode_spec(maker, sensor, scene, data, row), row, plans)


def repeat_search(maker: SimulatorBackend, scene: Scene, data: "DataSet", row: EpisodeRow) -> AdversaryTrack:
    """The adversary's track of a stored drive, with its candidates, by the same search, which finds the same track.

    ``maker`` drove it, with an adversary that keeps what it considers. Plans or an adversary that go elsewhere are
    refused.
    """
    stage = EpisodeSpec(scene, read_recorded_can(data, row.scene), row.run, maker, NoSensor(), _LONG_S, row.family)
    track = redrive(stage, row, StoredPlans(row)).adversary
    if track is None or AdversaryRow.model_validate(encode_adversary_track(stage, track)) != row.adversary:
        raise InputError(_format_mismatch(row))
    return track


def redrive(stage: EpisodeSpec, row: EpisodeRow, plans: "StoredPlans") -> Episode:
    """Drive stored plans on a stage; arguments and errors as of `redrive_with_sensor`."""
    if row.between:
        stage = replace(stage, plan_hz=10)
    if row.terminated:
        stage = replace(stage, most_plans=len(row.plans))
    episode = run_episode(stage, plans)
    ticks = episode.motion.ticks
    states = np.round(episode.motion.ego[ticks], DECIMALS).tolist()
    if (episode.motion.times_us[ticks].tolist(), states) != (row.ticks.time_us, row.ticks.ego):
        raise InputError(_format_mismatch(row))
    return episode


def _format_mismatch(row: EpisodeRow) -> str:
    return (
        f"the stored plans of {row.scene}, run {row.run}, give another trajectory: the engine or the data set "
        "has changed since; run the same drive command again"
    )


class StoredPlans:
    """The planner of a drive that was driven already: its plans, in their order."""

    name = "stored plans"

    def __init__(self, row: EpisodeRow) -> None:
        between = [*row.between, *[[]] * len(row.plans)]
        stored = [plan for first, others in zip(row.plans, between) for plan in (first, *others)]
        self._plans = [Plan(np.array(plan.waypoints, np.float64), PlanFrame(plan.frame)) for plan in stored]
        self._next = 0

    def reset(self, scene: SceneInfo) -> None:
        """Begin with the first."""
        self._next = 0

    def plan(self, observation: Observation) -> Plan:
        """The next one; raises `LookupError` where there is none."""
        if self._next >= len(self._plans):
            raise LookupError("there are no more stored plans")
        self._next += 1
        return self._plans[self._next - 1]
