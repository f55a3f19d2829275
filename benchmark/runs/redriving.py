"""Drives driven again by their stored plans, and scored anew: no planner is asked."""

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.closed_loop.adversary import AdversaryTrack, GivenTracks
from benchmark.closed_loop.default_engine import DefaultRides
from benchmark.closed_loop.driving import Drive, Stage, drive
from benchmark.closed_loop.observing import NoSensor, Sensor
from benchmark.closed_loop.riding import RecordedCan, RideMaker
from benchmark.closed_loop.scoring import score_drive
from benchmark.errors import InputError
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.records.drive_schema import AdversaryRow, DriveRow
from benchmark.runs.drive_rows import DECIMALS, adversary_row, row_of, track_of
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_LONG_S: Final = 3600.0
"""Nothing that is stored is late."""


def can_of(data: "DataSet", name: str) -> RecordedCan:
    """Measurements of the recorded car in a scene."""
    return RecordedCan.of((observation.ego for observation in data.observations(name)), data.root)


def driven_again(maker: RideMaker, scene: Scene, data: "DataSet", row: DriveRow) -> DriveRow:
    """Drive the stored plans of a drive and score it anew, without its planner.

    A failed one stays as it is: it has no scores.

    Raises:
        InputError: If the plans lead elsewhere than they did.
    """
    if row.status == "failed":
        return row
    stage = _stage(maker, NoSensor(), scene, data, row)
    episode = redriven(stage, row, StoredPlans(row))
    rescored_row = row_of(stage, episode, None if episode.failure is not None else score_drive(scene, episode))
    rescored_row = rescored_row.model_copy(update={"ladder": row.ladder})
    if (rescored_row.ticks, rescored_row.contact, rescored_row.passed) != (row.ticks, row.contact, row.passed):
        raise InputError(_elsewhere(row))
    return rescored_row


def _stage(maker: RideMaker, sensor: Sensor, scene: Scene, data: "DataSet", row: DriveRow) -> Stage:
    return Stage(scene, can_of(data, row.scene), row.run, _with_its_adversary(maker, row), sensor, _LONG_S, row.family)


def _with_its_adversary(maker: RideMaker, row: DriveRow) -> RideMaker:
    """A maker whose adversary drives its stored track again, without a search."""
    track = track_of(row)
    if track is None or not isinstance(maker, DefaultRides) or maker.adversary is None:
        return maker
    return replace(maker, adversary=GivenTracks({(row.scene, row.run): track}, maker.adversary.others))


def seen_again(
    maker: RideMaker, sensor: Sensor, scene: Scene, data: "DataSet", row: DriveRow, plans: "StoredPlans"
) -> Drive:
    """A stored drive with all objects in it, from its plans; one in which the planner failed ends where it did.

    Raises:
        InputError: If the plans lead elsewhere than they did.
    """
    return redriven(_stage(maker, sensor, scene, data, row), row, plans)


def considered_again(maker: RideMaker, scene: Scene, data: "DataSet", row: DriveRow) -> AdversaryTrack:
    """The adversary's track of a stored drive, with its candidates, searched anew.

    The same search finds the same track.

    Args:
        maker: The engine that drove it, with an adversary that keeps what it considers.

    Raises:
        InputError: If the plans lead elsewhere than they did, or the adversary goes elsewhere.
    """
    stage = Stage(scene, can_of(data, row.scene), row.run, maker, NoSensor(), _LONG_S, row.family)
    track = redriven(stage, row, StoredPlans(row)).adversary
    if track is None or AdversaryRow.model_validate(adversary_row(stage, track)) != row.adversary:
        raise InputError(_elsewhere(row))
    return track


def redriven(stage: Stage, row: DriveRow, plans: "StoredPlans") -> Drive:
    """Drive stored plans on a stage; arguments and errors as of `seen_again`."""
    episode = drive(stage, plans)
    ticks = episode.motion.ticks
    states = np.round(episode.motion.ego[ticks], DECIMALS).tolist()
    if (episode.motion.times_us[ticks].tolist(), states) != (row.ticks.time_us, row.ticks.ego):
        raise InputError(_elsewhere(row))
    return episode


def _elsewhere(row: DriveRow) -> str:
    return (
        f"the stored plans of {row.scene}, run {row.run}, lead elsewhere than they did: the engine or the data set "
        "has changed since; run the same drive command again"
    )


class StoredPlans:
    """The planner of a drive that was driven already: its plans, in their order."""

    name = "stored plans"

    def __init__(self, row: DriveRow) -> None:
        self._plans = [Plan(np.array(plan.waypoints, np.float64), PlanFrame(plan.frame)) for plan in row.plans]
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
