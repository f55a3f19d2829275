"""Recorded and lane paths with other timing: candidates beside those of the diffusion model (``docs/generation.md``).

Each edit follows the recording up to a frame and then drives a path as a speed law says. Edits are looked at as points
on their path first; those that would press the ego are driven by the simulator, so that they are motions of a car.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import (
    REAR_AXLE_BEHIND_CENTER,
    WHEELBASE,
    MotionModel,
    follow_path,
)
from benchmark.dynamics.reference_path import WAYPOINTS, build_reference_path
from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap, to_local
from benchmark.interactions.driver_outcomes import CollisionChecker
from benchmark.interactions.driver_simulation import DrivingSituation, ReferenceDriver, simulate_drivers
from benchmark.interactions.reaction import Driver
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.machine.identity_cache import IdentityCache
from benchmark.scene import Scene
from generation.extensions.effect.edits import SpeedLaw, compute_stations, list_laws, scale_law
from generation.extensions.effect.paths import LaneGraph, VehiclePath, list_lane_paths, list_recorded_paths
from generation.extensions.effect.pressure import EgoPlans
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_ego_path import get_ego_path
from generation.search.recorded_motion import AHEAD_S, compute_initial_state, is_driving_forward, is_vulnerable
from generation.search.threat_settings import CandidateProposal

EVERY_S: Final = 1.0
"""Between the frames from which edits start; twice that where paths are not recorded."""
AIR_M: Final = 0.25
LEVELS: Final = (0.05, 0.015)
"""Shares of the ego's plans that an edit should touch: edits above the first level come before those above the next."""
MOST_ALIKE: Final = 2
"""Edits of one path from one frame that are looked at further."""
MOST_PLACED, MOST_DRIVEN = 60, 8
"""Edits of a vehicle that are looked at for contacts, and of them those that the simulator drives."""
OVER_M: Final = 10.0
MEETING_M: Final = 3.0
"""A path meets the ego's where it comes so near to where the ego is in the next 8 s, or a little farther on."""
LEAST_MOVED_M: Final = 0.5
NEAR_M: Final = 25.0
STRENGTHS: Final = (0.5, 0.8, 1.1, 1.5)
"""Of an edit, times what was found on its path; a car is not exactly where a point would be."""
BISECTIONS: Final = 6
"""Of the interval between two of them: to less than a hundredth."""


@dataclass(frozen=True, slots=True)
class Edit:
    """A path and a speed law from a ``start`` frame on; ``pressure`` and ``moved_m`` as found on its track."""

    path: VehiclePath
    start: int
    law: SpeedLaw
    pressure: float = 0.0
    moved_m: float = 0.0


@dataclass(frozen=True, slots=True)
class RetimedTrack:
    """(F, 3) poses of the box centre of an edit that was driven, from its ``start`` frame to the end of the scene."""

    edit: Edit
    poses: Floats

    @property
    def start(self) -> int:
        """Frame of the launch."""
        return self.edit.start


def _rank_edit(edit: Edit) -> tuple[int, float, int]:
    """Strong edits first, each level by how little it moves."""
    return sum(edit.pressure < level for level in LEVELS), edit.moved_m, edit.start


class Retiming:
    """Edits of one vehicle of a scene that press the ego and touch nobody, the smallest of the strongest first."""

    def __init__(self, scene: Scene, agent: int, hyper: HyperParameters) -> None:
        self.scene, self.agent, self.hyper = scene, agent, hyper
        shapely.prepare(scene.road_map.drivable_area)
        self._tracks = ContinuousTracks.of_scene(scene)
        self._walks = is_vulnerable(scene, agent)
        self._pull_outs: list[VehiclePath] | None = None
        self._last = len(scene.timestamps_us) - 1
        self._size = scene.agents.size[agent, :2].astype(np.float64)
        self._plans = EgoPlans.of(scene)
        valid = scene.agents.valid[agent]
        centers = scene.agents.position[agent, valid, :2]
        step = np.hypot(*np.diff(centers, axis=0).T) * FRAME_HZ
        self._fastest = float(np.convolve(step, np.full(6, 1 / 6), mode="valid").max()) if len(step) >= 6 else 0.0
        self.parked = bool(np.ptp(centers, axis=0).max(initial=0.0) < hyper.least_motion_m)

    def find_tracks(self) -> Iterator[RetimedTrack]:
        """Driven edits in the order in which they should be judged."""
        driven = 0
        for edit in self._find_edits()[:MOST_PLACED]:
            if not self._is_clear(self._place(edit.path, edit.start, [edit.law]), edit.start)[0]:
                continue
            driven += 1
            track = self._find_weakest(edit)
            if track is not None and self._is_answered(track):
                yield track
            if driven >= MOST_DRIVEN:
                return

    def _find_edits(self) -> list[Edit]:
        """Edits that press the ego as points on their path: strong ones first, each level by how little it moves."""
        found: list[Edit] = []
        for start in self._list_starts():
            for path in self._list_paths(start):
                laws = self._list_laws(path, start)
                if not laws:
                    continue
                poses = self._place(path, start, laws)
                found += self._select(path, start, laws, poses)
        return sorted(found, key=_rank_edit)

    def _select(self, path: VehiclePath, start: int, laws: Sequence[SpeedLaw], poses: Floats) -> list[Edit]:
        near = self._plans.are_near(poses, start)
        moved = self._measure_moved(poses, start)
        rows = np.flatnonzero(near & (moved >= LEAST_MOVED_M))
        if not len(rows):
            return []
        pressure = np.zeros(len(poses))
        pressure[rows] = self._plans.measure_pressure(self._box(poses[rows]), start)
        rows = rows[pressure[rows] >= LEVELS[-1]]
        # The ego alone first: many edits that press it hit it, and the others are many.
        rows = rows[self._is_clear(poses[rows], start, ego_alone=True)] if len(rows) else rows
        edits = [Edit(path, start, laws[row], float(pressure[row]), float(moved[row])) for row in rows.tolist()]
        return sorted(edits, key=_rank_edit)[:MOST_ALIKE]

    def _list_starts(self) -> list[int]:
        """Frames from which it may leave its recording: it has been there, drives forwards, and time is left."""
        valid, hyper = self.scene.agents.valid[self.agent], self.hyper
        step = round(EVERY_S * FRAME_HZ) * (1 if self.parked or hyper.proposal is CandidateProposal.RETIMED else 2)
        frames = range(hyper.history_frames, self._last - hyper.shortest_drive_frames, step)
        return [
            frame
            for frame in frames
            if valid[frame - hyper.history_frames : frame + 1].all()
            and is_driving_forward(self.scene, self.agent, frame)
        ]

    def _list_paths(self, start: int) -> list[VehiclePath]:
        graph, retimed = _get_graph(self.scene), self.hyper.proposal is CandidateProposal.RETIMED
        if self.parked:
            # It stands where it stands: the same paths at every frame.
            if self._pull_outs is None:
                paths = list_lane_paths(self.scene, self.agent, start, graph)
                self._pull_outs = [] if retimed else [path for path in paths if self._is_on_road(path)]
            found = self._pull_outs
        else:
            list_paths = list_recorded_paths if retimed else list_lane_paths
            found = list(list_paths(self.scene, self.agent, start, graph))
        met = [path for path in found if self._meets_ego(path, start)]
        return met if retimed or self.parked else [path for path in met if self._is_on_road(path)]

    def _meets_ego(self, path: VehiclePath, start: int) -> bool:
        """Whether a path comes to where the ego drives in the next 8 s."""
        way, until = get_ego_path(self.scene), min(start + round(AHEAD_S * FRAME_HZ), self._last)
        low, high = np.searchsorted(way.stations, [way.station[start], way.station[until] + OVER_M])
        there = way.points[low:high:4]
        if not len(there):
            return False
        away = path.points[::4, None] - there
        return bool(((away**2).sum(axis=-1) <= MEETING_M**2).any())

    def _is_on_road(self, path: VehiclePath) -> bool:
        """Whether a path that is not recorded stays on the road, once it is there."""
        on = self.scene.road_map.is_drivable(path.points[::4])
        return bool(on[int(np.argmax(on)) :].mean() > 0.97) if on.any() else False

    def _list_laws(self, path: VehiclePath, start: int) -> list[SpeedLaw]:
        return list_laws(path.kind, self._speed_at(start), self._fastest)

    def _speed_at(self, start: int) -> float:
        return compute_initial_state(self.scene, self.agent, start, None).speed

    def _place(self, path: VehiclePath, start: int, laws: Sequence[SpeedLaw]) -> Floats:
        """(B, F, 3) poses of the box centre of points that keep to a path, from the start frame on."""
        station = self._compute_stations(path, start, laws)
        poses = path.at(station)
        ahead = REAR_AXLE_BEHIND_CENTER * self._size[0]
        poses[..., 0] += ahead * np.cos(poses[..., 2])
        poses[..., 1] += ahead * np.sin(poses[..., 2])
        return np.asarray(poses)

    def _compute_stations(self, path: VehiclePath, start: int, laws: Sequence[SpeedLaw]) -> Floats:
        return compute_stations(path, laws, self._speed_at(start), self._last - start + 1)

    def _measure_moved(self, poses: Floats, start: int) -> Floats:
        """(B,) mean distance from the recording, metres, where both are there (ADE)."""
        there = self.scene.agents.valid[self.agent, start:]
        recorded = self.scene.agents.position[self.agent, start:][there, :2]
        return np.asarray(np.linalg.norm(poses[:, there, :2] - recorded, axis=-1).mean(axis=1))

    def _box(self, poses: Floats) -> Floats:
        size = np.broadcast_to(self._size, (*poses.shape[:-1], 2))
        return np.concatenate([poses[..., :2], size, poses[..., 2:]], axis=-1)

    def _is_clear(self, poses: Floats, start: int, *, ego_alone: bool = False) -> Bools:
        """(B,) whether tracks stay in the area and clear of all others and of the ego."""
        boxes = self._box(poses)
        boxes[..., 2:4] += 2 * AIR_M
        ego = self.scene.ego.pose[start:]
        local = np.stack([to_local(track[:, :2], ego) for track in poses])
        clear = (np.abs(local) <= self.hyper.half_extent_m).all(axis=(1, 2))
        others = np.concatenate([self._tracks.agents[:, start:], self._tracks.ego[None, start:]])
        there = np.concatenate([self._tracks.valid[:, start:], np.ones((1, self._last - start + 1), np.bool_)])
        there[self.agent] = False
        reach = 0.5 * (np.hypot(others[:, 0, 2], others[:, 0, 3]) + np.hypot(*boxes[0, 0, 2:4]))
        for other in [len(others) - 1] if ego_alone else np.flatnonzero(there.any(axis=1)).tolist():
            away = boxes[..., :2] - others[other, :, :2]
            row, frame = np.nonzero((away[..., 0] ** 2 + away[..., 1] ** 2 <= reach[other] ** 2) & there[other])
            hit = boxes_overlap(boxes[row, frame], others[other, frame])
            clear[row[hit]] = False
        return np.asarray(clear)

    def _drive(self, edit: Edit, strength: float) -> RetimedTrack | None:
        """The edit, that many times as strong, as a car drives it; ``None`` where it is not clear or off the road."""
        edit = replace(edit, law=scale_law(edit.law, self._speed_at(edit.start), strength))
        poses = self._place(edit.path, edit.start, [edit.law])[0] if self._walks else self._simulate(edit)
        if not np.isfinite(poses).all() or not self._is_clear(poses[None], edit.start)[0]:
            return None
        pressure = self._plans.measure_pressure(self._box(poses[None]), edit.start)[0]
        off = ~self.scene.road_map.is_drivable(box_corners(self._box(poses))).all(axis=-1)
        if not self._walks and off.mean() > self.hyper.most_corner_off_road_share:
            return None
        moved = self._measure_moved(poses[None], edit.start)[0]
        return RetimedTrack(replace(edit, pressure=float(pressure), moved_m=float(moved)), poses)

    def _find_weakest(self, edit: Edit) -> RetimedTrack | None:
        """The weakest form of an edit that presses as much as a level asks for once it is driven, by bisection."""
        strongest = self._find_strongest(edit)
        level = next((level for level in LEVELS if strongest is not None and strongest[1].edit.pressure >= level), None)
        if strongest is None or level is None:
            return None
        low, (high, best) = 0.0, strongest
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            weaker = self._drive(edit, middle)
            if weaker is not None and weaker.edit.pressure >= level:
                best, high = weaker, middle
            else:
                low = middle
        return best

    def _find_strongest(self, edit: Edit) -> tuple[float, RetimedTrack] | None:
        """The strongest form of an edit that is clear, and how strong it is: it passes the ego as near as it may."""
        best: tuple[float, RetimedTrack] | None = None
        high: float | None = None
        for strength in STRENGTHS:
            track = self._drive(edit, strength)
            if track is None:
                high = strength
                break
            best = strength, track
        if best is None or high is None:
            return best
        for _ in range(BISECTIONS):
            middle = 0.5 * (best[0] + high)
            track = self._drive(edit, middle)
            if track is None:
                high = middle
            else:
                best = middle, track
        return best

    def _simulate(self, edit: Edit) -> Floats:
        """(F, 3) poses of the box centre: tracker and bicycle, told anew where to be every second."""
        model, length = MotionModel.si(), float(self._size[0])
        state = compute_initial_state(self.scene, self.agent, edit.start, model.limits)
        pose, motion = state.pose, np.array([[state.speed], [state.acceleration], [state.steering]])
        station = self._compute_stations(edit.path, edit.start, [edit.law])[0]
        frames = len(station)
        ahead = FRAMES_PER_KEYFRAME * np.arange(1, WAYPOINTS + 1)
        final_speed = (station[-1] - station[-2]) if frames > 1 else 0.0
        axle = [pose[None]]
        for first in range(0, frames - 1, FRAME_HZ):
            at = first + ahead
            wanted = np.interp(at, np.arange(frames), station) + np.maximum(at - frames + 1, 0) * final_speed
            local = to_local(edit.path.at(wanted)[:, :2], pose)
            path = build_reference_path(
                local[None], dt=model.dt, frames_per_waypoint=model.frames_per_waypoint, smooth=model.smooth
            )
            steps = min(FRAME_HZ, frames - 1 - first)
            driven = follow_path(path, motion, wheelbase_m=WHEELBASE * length, steps=steps, model=model).states[..., 0]
            cos, sin = np.cos(pose[2]), np.sin(pose[2])
            x = pose[0] + cos * driven[1:, 0] - sin * driven[1:, 1]
            y = pose[1] + sin * driven[1:, 0] + cos * driven[1:, 1]
            axle.append(np.column_stack([x, y, pose[2] + driven[1:, 2]]))
            pose, motion = axle[-1][-1], driven[-1, 3:, None]
        track = np.concatenate(axle)
        back = REAR_AXLE_BEHIND_CENTER * length
        center = track[:, :2] + back * np.stack([np.cos(track[:, 2]), np.sin(track[:, 2])], axis=1)
        return np.column_stack([center, track[:, 2]])

    def _is_answered(self, track: RetimedTrack) -> bool:
        """Whether a careful human survives it, among those near."""
        frames = slice(track.start, self._last + 1)
        boxes, valid = self._tracks.agents.copy(), self._tracks.valid.copy()
        boxes[self.agent, frames] = self._box(track.poses)
        valid[self.agent, frames] = True
        away = np.hypot(*np.moveaxis(boxes[..., :2] - self._tracks.ego[:, :2], -1, 0))
        near = (np.where(valid, away, np.inf) <= NEAR_M).any(axis=1)
        tracks = ContinuousTracks(self._tracks.seconds, self._tracks.ego, boxes, valid, self._tracks.categories)
        situation = DrivingSituation.of(tracks.only(near))
        (motion,) = simulate_drivers(situation, [ReferenceDriver(Driver.CC)])
        return CollisionChecker.of(situation).find_outcome(motion).survives


_get_graph: Final = IdentityCache[Scene, LaneGraph](lambda scene: LaneGraph(scene.road_map), kept=2)


def iterate_retimings(scene: Scene, agent: int, hyper: HyperParameters) -> Iterator[tuple[int, Floats]]:
    """Frame of the launch and (F, 3) poses of the box centre, to the end of the scene, of edits of one vehicle.

    With ``proposal=retimed`` on its recorded path, with ``rerouted`` on lanes that it did not take.
    """
    for track in Retiming(scene, agent, hyper).find_tracks():
        yield track.start, track.poses
