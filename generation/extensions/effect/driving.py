"""Edits of a vehicle's motion, and the simulator that drives them, so that they are motions of a car."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import (
    REAR_AXLE_BEHIND_CENTER,
    WHEELBASE,
    MotionModel,
    VehicleState,
    follow_path,
)
from benchmark.dynamics.reference_path import WAYPOINTS, build_reference_path
from benchmark.geometry import Floats, to_global, to_local
from benchmark.scene import Scene
from generation.extensions.effect.edits import SpeedLaw, scale_law
from generation.extensions.effect.leading import LeadLaw
from generation.extensions.effect.paths import VehiclePath

STEADY_S: Final = 0.5
"""Speed at which a recorded pace goes on after its end: the mean of so long before it."""


@dataclass(frozen=True, slots=True)
class Swerve:
    """``aside_m`` to the left at a station of a path, from ``reach_m`` before it to as much behind it."""

    at_m: float
    reach_m: float
    aside_m: float


@dataclass(frozen=True, slots=True)
class Edit:
    """A path and a speed law from a ``start`` frame on; without a law at its recorded pace, with a swerve aside.

    ``pressure`` and ``moved_m`` as found on its track.
    """

    path: VehiclePath
    start: int
    law: SpeedLaw | LeadLaw | None
    swerve: Swerve | None = None
    pressure: float = 0.0
    moved_m: float = 0.0

    def driven_path(self) -> VehiclePath | None:
        """The path with its swerve; ``None`` where it is too tight for a car."""
        if self.swerve is None:
            return self.path
        return self.path.swerved(self.swerve.at_m, self.swerve.reach_m, self.swerve.aside_m)

    def scaled(self, before: float, strength: float) -> "Edit":
        """The same, that many times as strong; ``before`` is the speed at its start, m/s."""
        if self.swerve is not None:
            return replace(self, swerve=replace(self.swerve, aside_m=strength * self.swerve.aside_m))
        if isinstance(self.law, LeadLaw):
            return replace(self, law=replace(self.law, gap_m=self.law.gap_m / strength))
        return self if self.law is None else replace(self, law=scale_law(self.law, before, strength))


@dataclass(frozen=True, slots=True)
class RetimedTrack:
    """(F, 3) poses of the box centre of an edit that was driven, from its ``start`` frame to the end of the scene."""

    edit: Edit
    poses: Floats

    @property
    def start(self) -> int:
        """Frame of the launch."""
        return self.edit.start


def compute_recorded_stations(scene: Scene, agent: int, start: int, frames: int) -> Floats:
    """(F,) metres that a vehicle drives from a frame on as recorded, and on at its last speed; never backwards."""
    valid = scene.agents.valid[agent, start:]
    there = int(np.argmin(valid)) if not valid.all() else len(valid)
    centers = scene.agents.position[agent, start : start + there, :2]
    heading = scene.agents.yaw[agent, start : start + there]
    step = (np.diff(centers, axis=0) * np.column_stack([np.cos(heading), np.sin(heading)])[:-1]).sum(axis=1)
    station = np.concatenate([[0.0], np.cumsum(np.maximum(step, 0.0))])[:frames]
    back = min(round(STEADY_S * FRAME_HZ), len(station) - 1)
    speed = (station[-1] - station[-1 - back]) / back if back else 0.0
    return np.concatenate([station, station[-1] + speed * np.arange(1, frames - len(station) + 1)])


def drive_stations(
    paths: Sequence[VehiclePath], stations: Floats, state: VehicleState, length_m: float, model: MotionModel
) -> Floats:
    """(B, F, 3) poses of the box centre: tracker and bicycle, told anew every second where (B, F) stations say to be.

    ``state`` is the motion at the first frame; ``paths`` are B.
    """
    count, frames = stations.shape
    pose, motion = np.tile(state.pose, (count, 1)), np.array([[state.speed], [state.acceleration], [state.steering]])
    ahead = FRAMES_PER_KEYFRAME * np.arange(1, WAYPOINTS + 1)
    final_step = (stations[:, -1:] - stations[:, -2:-1]) if frames > 1 else np.zeros((count, 1))
    axle = [pose[:, None]]
    for first in range(0, frames - 1, FRAME_HZ):
        at = first + ahead
        wanted = stations[:, np.minimum(at, frames - 1)] + np.maximum(at - frames + 1, 0) * final_step
        points = np.stack([path.at(row)[:, :2] for path, row in zip(paths, wanted, strict=True)])
        reference = build_reference_path(
            to_local(points, pose[:, None]),
            dt=model.dt,
            frames_per_waypoint=model.frames_per_waypoint,
            smooth=model.smooth,
        )
        steps = min(FRAME_HZ, frames - 1 - first)
        states = follow_path(reference, motion, wheelbase_m=WHEELBASE * length_m, steps=steps, model=model).states
        driven = states[1:].transpose(2, 0, 1)
        place = np.concatenate([to_global(driven[..., :2], pose[:, None]), driven[..., 2:3] + pose[:, None, 2:]], -1)
        axle.append(place)
        pose, motion = place[:, -1], states[-1, 3:]
    return shift_to_center(np.concatenate(axle, axis=1), length_m)


def shift_to_center(axle: Floats, length_m: float) -> Floats:
    """(..., 3) poses of the box centre from those of the rear axle."""
    ahead = REAR_AXLE_BEHIND_CENTER * length_m
    yaw = axle[..., 2]
    shift = ahead * np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    return np.asarray(axle + shift)
