"""Terms that ask a candidate to threaten the ego as traffic does and not to drive against lanes, beside the paper's.

``docs/generation.md``, "Terms of a threat", has each as an equation. All are means over half seconds of what is scored,
so that weights compare with those of the paper's terms, and lower is better.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from benchmark.constants import FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import WHEELBASE, SimulatedMotion
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.machine.identity_cache import IdentityCache
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_ego_path import RecordedEgoPath, get_ego_path
from generation.search.scoring import ScoringSurroundings, find_collisions

SPACING_M: Final = 1.0
WITHIN_M: Final = 2.0
"""A centre line as near as this is the vehicle's lane, or one of several where they cross."""
NEIGHBOURS: Final = 8
AGAINST_RAD: Final = np.pi / 2


@dataclass(frozen=True)
class LaneHeadings:
    """Points along the centre lines of a map, (V, 2) global metres, and (V,) headings of the lane there, radians."""

    points: Floats
    headings: Floats

    @classmethod
    def of(cls, scene: Scene) -> "LaneHeadings":
        """Those of a scene's map."""
        return _get_lane_headings(scene.road_map)

    def against(self, poses: Floats) -> Bools:
        """Whether poses (..., 3) head against every lane whose centre line is within 2 m; not where there is none."""
        if not len(self.points):
            return np.zeros(poses.shape[:-1], np.bool_)
        count = min(NEIGHBOURS, len(self.points))
        away, nearest = self._tree.query(poses[..., :2], k=[*range(1, count + 1)], distance_upper_bound=WITHIN_M)
        has_lane = np.isfinite(away)
        headings = self.headings[np.where(has_lane, nearest, 0)]
        along = np.abs(wrap_angle(poses[..., 2:] - headings)) <= AGAINST_RAD
        return np.asarray(has_lane.any(axis=-1) & ~(has_lane & along).any(axis=-1))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)


def _collect_points(road_map: RoadMap) -> LaneHeadings:
    points, headings = [np.zeros((0, 2))], [np.zeros(0)]
    for lane in road_map.lanes.values():
        edge = np.diff(lane.centerline, axis=0)
        length = np.hypot(edge[:, 0], edge[:, 1])
        stations = np.concatenate([[0.0], np.cumsum(length)])
        at = np.arange(0.5 * SPACING_M, stations[-1], SPACING_M)
        segment = np.clip(np.searchsorted(stations, at, side="right") - 1, 0, len(edge) - 1)
        points.append(np.column_stack([np.interp(at, stations, lane.centerline[:, axis]) for axis in range(2)]))
        headings.append(np.arctan2(edge[segment, 1], edge[segment, 0]))
    return LaneHeadings(np.concatenate(points), np.concatenate(headings))


_get_lane_headings: Final = IdentityCache[RoadMap, LaneHeadings](_collect_points, kept=2)


FAR_M: Final = 20.0
"""Distance from the place that is aimed at which counts as 1."""
OVERRUN_SHARE: Final = 0.6
"""Of what an ego that does not react would overrun, to be hit for certain and not only touched."""
OVERLAP_M: Final = 0.6
"""By how much a body reaches into the ego's strip that is in its way for certain."""
REACTION_S: Final = 1.1
"""How long a careful human closes before full braking: 0.8 s of reaction, and half the time in which braking rises."""
BRAKING_M_S2: Final = 0.774 * 9.81
MOVING_M_S: Final = 1.0
"""Nothing beside or behind an ego slower than this presses it."""
BRISK_M_S: Final = 4.0
"""Closing speed that earns all of the reward for it."""
HOVER_M: Final = 0.5
USUAL_ALONG_M_S2: Final = 1.0
USUAL_ACROSS_M_S2: Final = 0.7
"""Scales of the Laplace distributions that stand for what recorded drivers ask for."""
AHEAD_M: Final = 8.0
"""Room ahead of the ego at which an adversary is surely ahead of it."""
MOST_BEHIND: Final = 3.0
"""Largest distance behind, in units of 20 m; larger ones are clipped to it."""
FREE_SHARE: Final = 0.6
"""Share of half the area's side within which nothing is said of its edge."""


@dataclass(frozen=True)
class EgoLookahead:
    """Knowledge at a planning frame of the S scored frames that count, half a second apart where there are such.

    ``columns`` says which of the scored frames they are, ``offsets`` counts frames after the planning frame; ``ego``
    are the (S, 3) poses of its rear axle.
    """

    columns: tuple[int, ...]
    offsets: tuple[int, ...]
    way: RecordedEgoPath
    frames: tuple[int, ...]
    ego: Floats

    @classmethod
    def of(cls, scene: Scene, frame: int, offsets: tuple[int, ...]) -> "EgoLookahead":
        """Look ahead from a planning frame to the scored frames at some offsets from it."""
        columns = [column for column, offset in enumerate(offsets) if offset % FRAMES_PER_KEYFRAME == 0]
        columns = columns or [len(offsets) - 1]
        chosen = tuple(offsets[column] for column in columns)
        frames = tuple(frame + offset for offset in chosen)
        return cls(tuple(columns), chosen, get_ego_path(scene), frames, scene.ego.pose[list(frames)])

    @cached_property
    def speed(self) -> Floats:
        """(S,) of the ego, m/s."""
        return self.way.speed[list(self.frames)]

    def compute_aim_m(self, gap_s: float, least_m: float) -> Floats:
        """(S,) room ahead of the ego that is aimed at: a time gap, or well within what the ego would overrun."""
        over = self.way.overrun[list(self.frames)]
        gap = gap_s * self.speed
        return np.maximum(least_m, np.where(over >= least_m, np.minimum(gap, OVERRUN_SHARE * over), gap))


@dataclass(frozen=True)
class ThreatPlacement:
    """B candidates at S frames, along the ego's way, in metres and m/s.

    ``room`` is from the ego's front to the candidate's rear, negative where they overlap or it is behind; ``lag`` from
    the candidate's front to the ego's rear; ``side`` from the ego's strip to the candidate, negative where it reaches
    in; ``closing`` by how much the ego is faster along the way. (B, S); ``ego_speed`` is (S,).
    """

    room: Floats
    lag: Floats
    side: Floats
    closing: Floats
    ego_speed: Floats

    @classmethod
    def of(cls, ahead: EgoLookahead, center: Floats, speed: Floats, size: Floats) -> "ThreatPlacement":
        """Place (B, S, 3) poses of box centres, with (B, S) speeds and (2,) length and width, at the S frames."""
        way = ahead.way
        station, offset, turn = way.places(center, ahead.frames[0], ahead.frames[-1])
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        along, across = 0.5 * (cos * size[0] + sin * size[1]), 0.5 * (sin * size[0] + cos * size[1])
        lead = station - way.station[list(ahead.frames)]
        return cls(
            room=lead - along - 0.5 * way.length_m,
            lag=-lead - along - 0.5 * way.length_m,
            side=np.abs(offset) - across - 0.5 * way.width_m,
            closing=ahead.speed - speed * np.cos(turn),
            ego_speed=ahead.speed,
        )

    @cached_property
    def in_way(self) -> Bools:
        """(B, S) in the ego's strip ahead of it."""
        return np.asarray((self.side <= 0.0) & (self.room > 0.0))

    @cached_property
    def braking_m(self) -> Floats:
        """(B, S) metres in which a careful human loses the closing speed, 0 where the ego does not close."""
        closing = np.maximum(self.closing, 0.0)
        return REACTION_S * closing + closing**2 / (2.0 * BRAKING_M_S2)

    @property
    def moving(self) -> Bools:
        """(S,) whether the ego drives."""
        return np.asarray(self.ego_speed >= MOVING_M_S)


def compute_threat(placed: ThreatPlacement, aim_m: Floats) -> Floats:
    """(B,) distance to the place ahead of the ego where one that does not react would hit; its root, 1 at 20 m."""
    away = np.hypot(placed.room - aim_m, np.maximum(placed.side + OVERLAP_M, 0.0))
    return np.asarray(np.sqrt(away / FAR_M).mean(axis=1))


def compute_closing(placed: ThreatPlacement) -> Floats:
    """(B,) minus the share of a brisk closing speed, where the ego closes in time for a careful human; at least -1."""
    timely = placed.in_way & (placed.room >= placed.braking_m) & (placed.room <= 3.0 * placed.braking_m)
    return np.asarray(-(timely * np.clip(placed.closing / BRISK_M_S, 0.0, 1.0)).mean(axis=1))


def compute_braking_deficit(placed: ThreatPlacement) -> Floats:
    """(B,) share of a careful human's braking distance that is missing in the ego's way."""
    missing = np.maximum(placed.braking_m - placed.room, 0.0) / np.maximum(placed.braking_m, 1.0)
    return np.asarray((placed.in_way * missing).mean(axis=1))


def compute_side_deficit(placed: ThreatPlacement, least_m: float, per_speed_s: float) -> Floats:
    """(B,) share of the side clearance that is missing beside a driving ego."""
    wanted = least_m + per_speed_s * placed.ego_speed
    abreast = (placed.room <= 0.0) & (placed.lag <= 0.0) & placed.moving
    return np.asarray((abreast * np.clip(1.0 - placed.side / wanted, 0.0, 1.0)).mean(axis=1))


def compute_share_behind(placed: ThreatPlacement) -> Floats:
    """(B,) share of frames at which it is behind a driving ego."""
    return np.asarray(((placed.lag > 0.0) & placed.moving).mean(axis=1))


def compute_distance_from_ahead(placed: ThreatPlacement) -> Floats:
    """(B,) how far the rear is from 8 m ahead of the ego's front at the end of what is scored, 1 at 20 m; at most 3."""
    return np.asarray(np.clip((AHEAD_M - placed.room[:, -1]) / FAR_M, 0.0, MOST_BEHIND))


def compute_unlikeliness(speed: Floats, acceleration: Floats, steering: Floats, length_m: float) -> Floats:
    """(B,) minus the logarithm of the Laplace likelihood of (B, S) accelerations, without its constant."""
    across = speed**2 * np.tan(steering) / (WHEELBASE * length_m)
    return np.asarray((np.abs(acceleration) / USUAL_ALONG_M_S2 + np.abs(across) / USUAL_ACROSS_M_S2).mean(axis=1))


def compute_edge_penalty(center: Floats, ego: Floats, half_extent_m: float) -> Floats:
    """(B,) how far beyond the free part of the area, 1 at its edge; squared, so that the edge itself counts most.

    (B, S, 3) poses of box centres; the area lies around the (S, 3) poses ``ego``.
    """
    outward = np.maximum(*np.moveaxis(np.abs(to_local(center[..., :2], ego)), -1, 0))
    free = FREE_SHARE * half_extent_m
    return np.asarray(((np.maximum(outward - free, 0.0) / (half_extent_m - free)) ** 2).mean(axis=1))


def build_threat_rating(
    scene: Scene,
    agent: int,
    frame: int,
    offsets: tuple[int, ...],
    around: ScoringSurroundings,
    hyper: HyperParameters,
) -> Callable[[SimulatedMotion], Floats]:
    """Function of B motions for the (B,) weighted sums of terms at a frame; ``offsets`` after it are scored."""
    ahead = EgoLookahead.of(scene, frame, offsets)
    size = scene.agents.size[agent, :2]
    columns = list(ahead.columns)
    scored_around = replace(around, boxes=around.boxes[columns], present=around.present[columns])
    lanes = LaneHeadings.of(scene) if hyper.against_weight else None
    aim_m = ahead.compute_aim_m(hyper.threat_gap_s, hyper.threat_least_m)

    def rate(motion: SimulatedMotion) -> Floats:
        ok = motion.finite
        center = np.where(ok[:, None, None], motion.center[:, list(ahead.offsets)], 0.0)
        states = np.where(ok[:, None, None], motion.states[:, list(ahead.offsets), 3:], 0.0)
        speed, acceleration, steering = np.moveaxis(states, -1, 0)
        placed = ThreatPlacement.of(ahead, center, speed, size)
        total = np.zeros(len(center))
        terms: tuple[tuple[float, Callable[[], Floats]], ...] = (
            (hyper.threat_weight, lambda: compute_threat(placed, aim_m)),
            (hyper.closing_weight, lambda: compute_closing(placed)),
            (hyper.careful_weight, lambda: compute_braking_deficit(placed)),
            (hyper.side_weight, lambda: compute_side_deficit(placed, hyper.side_least_m, hyper.side_s)),
            (hyper.behind_weight, lambda: compute_share_behind(placed)),
            (hyper.ahead_weight, lambda: compute_distance_from_ahead(placed)),
            (hyper.hover_weight, lambda: compute_hovering_share(center, size, scored_around)),
            (hyper.likelihood_weight, lambda: compute_unlikeliness(speed, acceleration, steering, float(size[0]))),
            (hyper.area_weight, lambda: compute_edge_penalty(center, ahead.ego, hyper.half_extent_m)),
        )
        for weight, term in terms:
            if weight:
                total += weight * term()
        if lanes is not None:
            total += hyper.against_weight * lanes.against(center).mean(axis=1)
        return total

    return rate


def compute_hovering_share(center: Floats, size: Floats, around: ScoringSurroundings) -> Floats:
    """(B,) share of frames with another within half a metre."""
    grown = np.broadcast_to(np.asarray(size) + 2.0 * HOVER_M, (*center.shape[:2], 2))
    boxes = np.concatenate([center[..., :2], grown, center[..., 2:]], axis=-1)
    return np.asarray(find_collisions(boxes, around).mean(axis=1))
