"""Recorded and lane paths with other timing, and swerves: candidates beside those of the diffusion model.

Each edit follows the recording up to a frame and then drives a path as a speed law says. Edits are looked at as points
on their path first; those that would press the ego are driven by the simulator, so that they are motions of a car.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
import shapely

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import MotionModel
from benchmark.fairness.validity import HOVERING_M, HOVERING_S
from benchmark.geometry import Bools, Floats, box_gap, boxes_overlap
from benchmark.interactions.driver_outcomes import CollisionChecker
from benchmark.interactions.driver_simulation import DrivingSituation, ReferenceDriver, simulate_drivers
from benchmark.interactions.reaction import Driver
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.machine.identity_cache import IdentityCache
from benchmark.scene import Scene
from generation.extensions.effect.behaviour import STICKING_M, STICKING_S, list_runs
from generation.extensions.effect.driving import (
    Edit,
    RetimedTrack,
    Swerve,
    compute_recorded_stations,
    drive_stations,
    shift_to_center,
)
from generation.extensions.effect.edits import SpeedLaw, compute_stations, list_laws
from generation.extensions.effect.leading import LEAD_LAWS, LeadLaw, LedEgo, compute_leading_stations, find_led_ego
from generation.extensions.effect.passings import find_passings
from generation.extensions.effect.paths import LaneGraph, VehiclePath, list_lane_paths, list_recorded_paths
from generation.extensions.effect.pressure import LEAST_PRESSURE, EgoPlans, count_levels
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_ego_path import get_ego_path
from generation.search.recorded_motion import AHEAD_S, compute_initial_state, is_driving_forward, is_vulnerable
from generation.search.threat_settings import CandidateProposal
from generation.search.verify import compute_raster_footprints, is_blocking_ego, measure_off_road

EVERY_S: Final = 1.0
"""Between the frames from which edits start; twice that for who moves off its path."""
AIR_M: Final = 0.25
OTHERS_AIR_M: Final = 0.12
"""Kept from the ego, and from all others: rows of parked cars are narrow."""
MOST_ALIKE: Final = 3
"""Edits of one path from one frame that are looked at further."""
MOST_PLACED, MOST_DRIVEN = 60, 8
"""Edits of a vehicle that are looked at for contacts, and of them those that the simulator drives."""
OVER_M: Final = 10.0
MEETING_M: Final = 3.0
"""A path meets the ego's where it comes so near to where the ego is in the next 8 s, or a little farther on."""
LEAST_MOVED_M: Final = 0.5
NEAR_M: Final = 25.0
STRENGTHS: Final = (0.3, 0.5, 0.7, 0.85, 1.0, 1.15, 1.35, 1.6)
"""Of an edit, times what was found on its path; a car is not exactly where a point would be."""
FINER, REFINEMENTS = 3, 2
"""Strengths between two neighbours of which one is better, and how often: to about a hundredth."""
SWERVING_S: Final = (1.5, 2.2, 3.0)
LEAST_SWERVE_M: Final = 5.0
"""Before the nearest moment, in which a vehicle swerves, and the way that it has for that at least."""
SWERVED_SHARES: Final = (0.7, 0.85, 1.0)
"""Of the gap that is left then."""


def _rank_edit(edit: Edit) -> tuple[int, float, int]:
    """Strong edits first, each level by how little it moves."""
    return -count_levels(edit.pressure), edit.moved_m, edit.start


class Retiming:
    """Edits of one vehicle of a scene that press the ego and touch nobody, the smallest of the strongest first."""

    def __init__(self, scene: Scene, agent: int, hyper: HyperParameters) -> None:
        self.scene, self.agent, self.hyper = scene, agent, hyper
        shapely.prepare(scene.road_map.drivable_area)
        self._tracks = ContinuousTracks.of_scene(scene)
        self._walks = is_vulnerable(scene, agent)
        self._pull_outs: list[VehiclePath] | None = None
        self._led: dict[tuple[int, int], tuple[VehiclePath, LedEgo | None]] = {}
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
        found: list[RetimedTrack] = []
        driven = 0
        for edit in self.find_edits()[:MOST_PLACED]:
            if self._is_clear(self._place([edit]), edit.start)[0]:
                track = self.find_weakest(edit)
                found += [] if track is None else [track]
                driven += 1
            if driven >= MOST_DRIVEN:
                break
        for track in sorted(found, key=lambda track: _rank_edit(track.edit)):
            if self._is_answered(track):
                yield track

    def find_edits(self) -> list[Edit]:
        """Edits that press the ego as points on their path: strong ones first, each level by how little it moves."""
        if self.hyper.proposal is CandidateProposal.SWERVED:
            return self._select_by_start(self._list_swerves())
        found: list[Edit] = []
        for start in self._list_starts():
            edits: list[Edit] = []
            for path in self._list_paths(start):
                led = not self._walks and self._find_led(path, start) is not None
                edits += [Edit(path, start, law) for law in list_laws(path.kind, self._speed_at(start), self._fastest)]
                edits += [Edit(path, start, law) for law in (LEAD_LAWS if led else ())]
            found += self._select(edits)
        return sorted(found, key=_rank_edit)

    def _select_by_start(self, edits: Sequence[Edit]) -> list[Edit]:
        found = [each for edit in edits for each in self._select([edit])]
        return sorted(found, key=_rank_edit)

    def _select(self, edits: Sequence[Edit]) -> list[Edit]:
        """Of edits from one frame those that press the ego, at most so many of one path."""
        if not edits:
            return []
        start, poses = edits[0].start, self._place(edits)
        rows = np.flatnonzero(self._plans.are_near(poses, start))
        pressure, moved = np.zeros(len(poses)), np.zeros(len(poses))
        moved[rows] = self._measure_moved(poses[rows], start)
        rows = rows[moved[rows] >= self._least_moved_m]
        if len(rows):
            pressure[rows] = self._plans.measure_pressure(self._box(poses[rows]), start)
        rows = rows[pressure[rows] >= LEAST_PRESSURE]
        # The ego alone first: many edits that press it hit it, and the others are many.
        rows = rows[self._is_clear(poses[rows], start, ego_alone=True)] if len(rows) else rows
        of_path: dict[int, list[Edit]] = {}
        for row in rows.tolist():
            edit = replace(edits[row], pressure=float(pressure[row]), moved_m=float(moved[row]))
            of_path.setdefault(id(edit.path), []).append(edit)
        return [edit for found in of_path.values() for edit in sorted(found, key=_rank_edit)[:MOST_ALIKE]]

    @property
    def _least_moved_m(self) -> float:
        return 0.0 if self.hyper.proposal is CandidateProposal.SWERVED else LEAST_MOVED_M

    def _list_starts(self) -> list[int]:
        """Frames from which it may leave its recording: it has been there, drives forwards, and time is left."""
        rerouted = self.hyper.proposal is CandidateProposal.REROUTED
        step = round(EVERY_S * FRAME_HZ) * (2 if rerouted and not self.parked else 1)
        frames = range(self.hyper.history_frames, self._last - self.hyper.shortest_drive_frames, step)
        return [frame for frame in frames if self._can_start(frame)]

    def _can_start(self, frame: int) -> bool:
        history = self.hyper.history_frames
        there = self.scene.agents.valid[self.agent, max(frame - history, 0) : frame + 1].all()
        late = frame > self._last - self.hyper.shortest_drive_frames
        return bool(history <= frame and not late and there) and is_driving_forward(self.scene, self.agent, frame)

    def _list_swerves(self) -> list[Edit]:
        """Its recorded path and timing, but towards the ego where it passes it, as near as may be."""
        edits = []
        for frame, gap, side, towards in find_passings(self._tracks, self.agent, self._plans.moving):
            for seconds in SWERVING_S:
                start = frame - round(seconds * FRAME_HZ)
                if not self._can_start(start):
                    continue
                at_m = float(compute_recorded_stations(self.scene, self.agent, start, frame - start + 1)[-1])
                if at_m < LEAST_SWERVE_M:
                    continue
                paths = list_recorded_paths(self.scene, self.agent, start, _get_graph(self.scene))
                aside = side * (gap - AIR_M)
                swerves = [Swerve(at_m, at_m, aside)]
                # Twice as far half-way to its end: one that overtakes somebody and comes back late.
                swerves += [Swerve(at_m / 1.5, at_m / 1.5, 2.0 * aside)] if towards else []
                edits += [
                    Edit(path, start, None, replace(swerve, aside_m=share * swerve.aside_m))
                    for path in list(paths)[:1]
                    for swerve in swerves
                    for share in SWERVED_SHARES
                ]
        return [edit for edit in edits if edit.driven_path() is not None]

    def _list_paths(self, start: int) -> list[VehiclePath]:
        graph, retimed = _get_graph(self.scene), self.hyper.proposal is CandidateProposal.RETIMED
        if self.parked:
            # It stands where it stands: the same paths at every frame.
            if self._pull_outs is None:
                paths = list_lane_paths(self.scene, self.agent, start, 0.0, graph)
                self._pull_outs = [] if retimed else [path for path in paths if self._is_on_road(path)]
            found = self._pull_outs
        else:
            found = list(
                list_recorded_paths(self.scene, self.agent, start, graph)
                if retimed
                else list_lane_paths(self.scene, self.agent, start, self._speed_at(start), graph)
            )
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

    def _speed_at(self, start: int) -> float:
        return compute_initial_state(self.scene, self.agent, start, None).speed

    def _compute_stations(self, edits: Sequence[Edit]) -> Floats:
        """(B, F) metres along their paths of edits from one frame."""
        start, frames = edits[0].start, self._last - edits[0].start + 1
        stations, speed = np.empty((len(edits), frames)), self._speed_at(start)
        timed = [row for row, edit in enumerate(edits) if isinstance(edit.law, SpeedLaw)]
        leading = [row for row, edit in enumerate(edits) if isinstance(edit.law, LeadLaw)]
        if len(timed) + len(leading) < len(edits):
            stations[:] = compute_recorded_stations(self.scene, self.agent, start, frames)
        if timed:
            paths = {id(edits[row].path): edits[row].path for row in timed}
            known = np.sort(list(paths))
            rows = np.searchsorted(known, [id(edits[row].path) for row in timed])
            laws = [law for row in timed if isinstance(law := edits[row].law, SpeedLaw)]
            stations[timed] = compute_stations([paths[key] for key in known.tolist()], rows, laws, speed, frames)
        if leading:
            egos = [ego for row in leading if (ego := self._find_led(edits[row].path, start)) is not None]
            laws_kept = [law for row in leading if isinstance(law := edits[row].law, LeadLaw)]
            own = [edits[row].path for row in leading]
            stations[leading] = compute_leading_stations(own, egos, laws_kept, speed, float(self._size[0]))
        return stations

    def _find_led(self, path: VehiclePath, start: int) -> LedEgo | None:
        key = (id(path), start)
        if key not in self._led:
            self._led[key] = path, find_led_ego(path, self._tracks.ego[start:])
        return self._led[key][1]

    def _place(self, edits: Sequence[Edit]) -> Floats:
        """(B, F, 3) poses of the box centre of points that keep to the paths of edits from one frame."""
        stations = self._compute_stations(edits)
        poses = np.empty((*stations.shape, 3))
        rows: dict[int, list[int]] = {}
        for row, edit in enumerate(edits):
            rows.setdefault(id(edit.path) if edit.swerve is None else -row - 1, []).append(row)
        for some in rows.values():
            path = edits[some[0]].driven_path()
            poses[some] = np.nan if path is None else path.at(stations[some])
        return shift_to_center(poses, float(self._size[0]))

    def _measure_moved(self, poses: Floats, start: int) -> Floats:
        """(B,) mean distance from the recording, metres, where both are there (ADE)."""
        there = self.scene.agents.valid[self.agent, start:]
        recorded = self.scene.agents.position[self.agent, start:][there, :2]
        return np.asarray(np.linalg.norm(poses[:, there, :2] - recorded, axis=-1).mean(axis=1))

    def _box(self, poses: Floats) -> Floats:
        size = np.broadcast_to(self._size, (*poses.shape[:-1], 2))
        return np.concatenate([poses[..., :2], size, poses[..., 2:]], axis=-1)

    def _is_clear(self, poses: Floats, start: int, *, ego_alone: bool = False) -> Bools:
        """(B,) whether tracks stay clear of all others and of the ego."""
        boxes = self._box(poses)
        clear = np.ones(len(poses), np.bool_)
        others = np.concatenate([self._tracks.agents[:, start:], self._tracks.ego[None, start:]])
        there = np.concatenate([self._tracks.valid[:, start:], np.ones((1, self._last - start + 1), np.bool_)])
        there[self.agent] = False
        wide = boxes.copy()
        wide[..., 2:4] += 2 * AIR_M
        boxes[..., 2:4] += 2 * OTHERS_AIR_M
        reach = 0.5 * (np.hypot(others[:, 0, 2], others[:, 0, 3]) + np.hypot(*wide[0, 0, 2:4]))
        for other in [len(others) - 1] if ego_alone else np.flatnonzero(there.any(axis=1)).tolist():
            away = boxes[..., :2] - others[other, :, :2]
            row, frame = np.nonzero((away[..., 0] ** 2 + away[..., 1] ** 2 <= reach[other] ** 2) & there[other])
            kept = wide if other == len(others) - 1 else boxes
            hit = boxes_overlap(kept[row, frame], others[other, frame])
            clear[row[hit]] = False
        return np.asarray(clear)

    def drive(self, edit: Edit, strengths: Sequence[float]) -> list[RetimedTrack | None]:
        """The edit, as strong as each says, as a car drives it; ``None`` where it is not clear or off the road."""
        start, before = edit.start, self._speed_at(edit.start)
        edits = [edit.scaled(before, strength) for strength in strengths]
        paths = [each.driven_path() for each in edits]
        possible = [(each, path) for each, path in zip(edits, paths, strict=True) if path is not None]
        tracks: dict[int, RetimedTrack] = {}
        if possible:
            some = [each for each, _ in possible]
            poses = self._place(some) if self._walks else self._simulate(some, [path for _, path in possible])
            fine = np.isfinite(poses).all(axis=(1, 2))
            fine[fine] &= self._is_clear(poses[fine], start) if fine.any() else False
            for row in np.flatnonzero(fine).tolist():
                track = self._judge_driven(some[row], poses[row])
                if track is not None:
                    tracks[id(some[row])] = track
        return [tracks.get(id(each)) for each in edits]

    def _judge_driven(self, edit: Edit, poses: Floats) -> RetimedTrack | None:
        boxes = self._box(poses)
        rasters = _get_raster_footprints(self.scene)[edit.start :]
        if boxes_overlap(boxes[:, None], rasters).any() or is_blocking_ego(self.scene, boxes, self.hyper):
            return None
        gap, seconds = box_gap(boxes, self._tracks.ego[edit.start :]), self._tracks.seconds[edit.start :]
        sticks = list_runs((gap <= STICKING_M) & self._plans.moving[edit.start :], seconds, STICKING_S)
        if any(sticks) or any(list_runs(gap < HOVERING_M, seconds, HOVERING_S)):
            return None
        if not self._walks:
            center_off, corner_off = measure_off_road(self.scene, boxes, self.hyper)
            if center_off.mean() > self.hyper.most_off_road_share:
                return None
            if corner_off.mean() > self.hyper.most_corner_off_road_share:
                return None
        pressure = self._plans.measure_pressure(boxes[None], edit.start)[0]
        moved = self._measure_moved(poses[None], edit.start)[0]
        return RetimedTrack(replace(edit, pressure=float(pressure), moved_m=float(moved)), poses)

    def find_weakest(self, edit: Edit) -> RetimedTrack | None:
        """The weakest form of an edit among those that press most once it is driven.

        An edit that hits the ego may be clear when it is weaker, or when it is stronger and comes before the ego. So
        strengths are tried over their whole range, and more of them between neighbours of which one is better.
        """
        tried: dict[float, RetimedTrack | None] = {}
        asked: Sequence[float] = STRENGTHS
        for _ in range(1 + REFINEMENTS):
            tried |= zip(asked, self.drive(edit, asked), strict=True)
            order = sorted(tried)
            asked = [
                low + (high - low) * step / (FINER + 1)
                for low, high in pairwise(order)
                if _compute_worth(tried[low]) != _compute_worth(tried[high])
                for step in range(1, FINER + 1)
            ]
            if not asked:
                break
        best = max((_compute_worth(track) for track in tried.values()), default=0)
        if best <= 0:
            return None
        return min(
            (track for track in tried.values() if track is not None and _compute_worth(track) == best),
            key=lambda track: track.edit.moved_m,
        )

    def _simulate(self, edits: Sequence[Edit], paths: Sequence[VehiclePath]) -> Floats:
        """(B, F, 3) poses of the box centre of edits from one frame, driven."""
        model = MotionModel.si()
        state = compute_initial_state(self.scene, self.agent, edits[0].start, model.limits)
        return drive_stations(paths, self._compute_stations(edits), state, float(self._size[0]), model)

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


def _compute_worth(track: RetimedTrack | None) -> int:
    """Levels of pressure of a driven edit; -1 for one that cannot be."""
    return -1 if track is None else count_levels(track.edit.pressure)


_get_graph: Final = IdentityCache[Scene, LaneGraph](lambda scene: LaneGraph(scene.road_map), kept=2)

_get_raster_footprints: Final = IdentityCache[Scene, Floats](
    lambda scene: compute_raster_footprints(scene, np.arange(len(scene.timestamps_us))), kept=2
)
"""Where native protocols see the ego at each frame: who is there would be masked."""


def iterate_retimings(scene: Scene, agent: int, hyper: HyperParameters) -> Iterator[tuple[int, Floats]]:
    """Frame of the launch and (F, 3) poses of the box centre, to the end of the scene, of edits of one vehicle.

    With ``proposal=retimed`` on its recorded path, with ``rerouted`` on lanes that it did not take, with ``swerved``
    as recorded but nearer to the ego where it passes it.
    """
    for track in Retiming(scene, agent, hyper).find_tracks():
        yield track.start, track.poses
