"""A vehicle and the ego, frame by frame, by station along the ego's driven path and offset to its left."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from benchmark.geometry import Bools, Floats, box_corners, box_gap, wrap_angle

VERTEX_STEP_M = 1.0
"""Distance of the path's vertices: closer ones would make headings out of the noise of a standing car."""
EXTENSION_M = 150.0
"""The path goes on by this much before its start and after its end."""
BEND_M = 24.0
"""So far it goes on with the curvature of its end, then straight; 3 s at 8 m/s."""
MOST_BEND_RAD = np.deg2rad(90.0)
CURVATURE_WINDOW_M = 5.0
"""Length of the end over which its curvature is measured."""
REACH_M = 90.0
"""A point belongs to the part of the path within this station of the ego: paths cross themselves."""
BODY_REACH_M = 15.0
"""The corners of a body belong to the part of the path within this station of its centre."""


_ROUNDING_M2 = 1e-9


@dataclass(frozen=True, slots=True)
class PathFrame:
    """Polyline of the ego's body centre, extended at both ends: (M, 2) vertices, metres, global.

    (M,) ``stations`` along it are 0 at the ego's first frame; (T,) ``ego_stations`` are of its centre at each frame.
    """

    vertices: Floats
    stations: Floats
    ego_stations: Floats

    @classmethod
    def of(cls, ego: Floats) -> Self:
        """The path of a recorded ego, (T, 5) body boxes, T >= 1."""
        centers = ego[:, :2]
        vertex_frames = _choose_vertices(centers)
        poses = ego[vertex_frames][:, [0, 1, 4]]
        # The past is a drive in reverse: the same arc, left behind.
        before = _extend(poses[::-1], backwards=True)[::-1]
        vertices = np.concatenate([before, poses[:, :2], _extend(poses, backwards=False)])
        stations = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(vertices, axis=0).T))])
        stations -= stations[len(before)]
        # Segment k leads on from the k-th vertex; the first kept frame comes after those of the past.
        segment = np.searchsorted(vertex_frames, np.arange(len(centers)), side="right") + len(before) - 1
        edge = np.diff(vertices, axis=0)[segment]
        length = np.hypot(edge[:, 0], edge[:, 1])
        along = ((centers - vertices[segment]) * edge).sum(axis=1) / length
        return cls(vertices, stations, stations[segment] + np.clip(along, 0.0, length))

    def project(self, points: Floats, around: Floats, reach_m: float) -> tuple[Floats, Floats, Floats]:
        """Nearest places on the path of (F, P, 2) points, metres, global, near the (F,) stations ``around``.

        (F, P) stations, (F, P) offsets (left of the path is positive), (F, P) headings of the path, radians.
        """
        begin, edge = self.vertices[:-1], np.diff(self.vertices, axis=0)
        length = np.hypot(edge[:, 0], edge[:, 1])
        # Window of each segment, (F, 1, M).
        low, high = (
            np.clip(around[:, None, None] + end * reach_m - self.stations[:-1], 0.0, length) for end in (-1, 1)
        )
        outside = (np.abs(around[:, None] - self.stations[:-1] - 0.5 * length) > reach_m + 0.5 * length)[:, None]
        offset = points[:, :, None] - begin
        along = np.clip((offset * edge).sum(axis=-1) / length, low, high)
        foot = begin + edge * (along / length)[..., None]
        distance = np.where(outside, np.inf, np.linalg.norm(points[:, :, None] - foot, axis=-1))
        station = self.stations[:-1] + along
        nearest = distance.argmin(axis=-1)[..., None]
        chosen = edge[nearest[..., 0]]
        rest = np.take_along_axis(offset, nearest[..., None], axis=2)[..., 0, :]
        side = np.sign(chosen[..., 0] * rest[..., 1] - chosen[..., 1] * rest[..., 0])
        return (
            np.take_along_axis(station, nearest, axis=-1)[..., 0],
            side * np.take_along_axis(distance, nearest, axis=-1)[..., 0],
            np.arctan2(chosen[..., 1], chosen[..., 0]),
        )


@dataclass(frozen=True, slots=True)
class Placement:
    """A body in the path frame: (F,) station, offset and ``turn`` (relative to the path, [-pi, pi)) of its centre.

    ``rear`` and ``front`` are the extreme stations of its corners, ``right`` and ``left`` the offsets, metres.
    """

    station: Floats
    offset: Floats
    turn: Floats
    rear: Floats
    front: Floats
    right: Floats
    left: Floats

    @classmethod
    def of(cls, path: PathFrame, boxes: Floats, frames: slice) -> Self:
        """Place (F, 5) boxes at F frames of the ego, by the middles of the sides too: a long body spans bends."""
        station, offset, heading = (
            part[:, 0] for part in path.project(boxes[:, None, :2], path.ego_stations[frames], REACH_M)
        )
        corners = box_corners(boxes)
        outline = np.concatenate([corners, 0.5 * (corners + np.roll(corners, 1, axis=1))], axis=1)
        along, across, _ = path.project(outline, station, BODY_REACH_M)
        return cls(
            station,
            offset,
            wrap_angle(boxes[:, 4] - heading),
            along.min(axis=1),
            along.max(axis=1),
            across.min(axis=1),
            across.max(axis=1),
        )


def _choose_vertices(centers: Floats) -> list[int]:
    """The first frame, and each that is a step or more from the one chosen before."""
    chosen, places = [0], centers.tolist()
    for frame, (x, y) in enumerate(places):
        last_x, last_y = places[chosen[-1]]
        aside, along = x - last_x, y - last_y
        squared = aside * aside + along * along
        # Only where rounding may decide does it need the distance itself, which numpy is slow to give one by one.
        near = abs(squared - VERTEX_STEP_M**2) < _ROUNDING_M2
        if np.hypot(aside, along) >= VERTEX_STEP_M if near else squared > VERTEX_STEP_M**2:
            chosen.append(frame)
    return chosen


def _extend(poses: Floats, *, backwards: bool) -> Floats:
    """(E, 2) vertices after the last of some poses (M, 3) on the path: an arc as before, then straight.

    Headings are those of the drive; ``backwards`` leads against them.
    """
    yaw = float(poses[-1, 2])
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)[::-1]
    way = np.concatenate([[0.0], np.cumsum(step)])
    curvature = 0.0
    if way[-1] >= CURVATURE_WINDOW_M:
        first = int(np.argmax(way >= CURVATURE_WINDOW_M))
        curvature = float(wrap_angle(yaw - poses[-1 - first, 2])) / float(way[first])
    ahead = np.arange(VERTEX_STEP_M, BEND_M + 0.5 * VERTEX_STEP_M, VERTEX_STEP_M)
    turned = np.clip(curvature * (ahead - 0.5 * VERTEX_STEP_M), -MOST_BEND_RAD, MOST_BEND_RAD)
    heading = yaw + np.concatenate([turned, [turned[-1]]])
    length = np.concatenate([np.full(len(ahead), VERTEX_STEP_M), [EXTENSION_M]])
    moves = length[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.asarray(poses[-1, :2] + np.cumsum(-moves if backwards else moves, axis=0))


MOVING_M_S = 1.0
"""Below this speed a body stands."""


@dataclass(frozen=True, slots=True)
class PathInteraction:
    """A vehicle (``other``) and the ego at F frames, in the frame of the ego's path, in metres and m/s.

    (F,) ``seconds`` are since the scene's first frame; ``speed`` is the vehicle's, ``along`` its part along the path,
    ``gap`` is between the bodies. ``half_width`` is of the strip that the ego sweeps.
    """

    seconds: Floats
    present: Bools
    ego: Placement
    other: Placement
    ego_speed: Floats
    speed: Floats
    along: Floats
    gap: Floats
    half_width: float

    @property
    def frame_s(self) -> float:
        """Mean time between frames."""
        return float(np.ptp(self.seconds)) / max(len(self.seconds) - 1, 1)

    @property
    def inside(self) -> Bools:
        """(F,) whether the vehicle's body reaches into the strip that the ego sweeps."""
        return self.is_within(0.0)

    def is_within(self, margin_m: float) -> Bools:
        """(F,) whether it reaches into the strip with a margin on both sides."""
        half = self.half_width + margin_m
        return np.asarray((self.other.right < half) & (self.other.left > -half) & self.present)

    @property
    def ahead(self) -> Bools:
        """(F,) whether its centre is ahead of the ego's."""
        return np.asarray(self.other.station > self.ego.station)

    @property
    def abreast(self) -> Bools:
        """(F,) whether the bodies overlap along the path."""
        return np.asarray((self.other.front > self.ego.rear) & (self.other.rear < self.ego.front) & self.present)

    @property
    def reach_s(self) -> Floats:
        """(F,) time until the ego's front is where the vehicle's rear is now, by the recording.

        After its end the ego goes on as fast as at the end: for ever, if it stands.
        """
        front = np.maximum.accumulate(self.ego.front)
        at = np.searchsorted(front, self.other.rear)
        later = self.seconds[np.minimum(at, len(front) - 1)]
        missing = np.maximum(self.other.rear - front[-1], 0.0)
        later = later + missing / max(float(self.ego_speed[-1]), 1e-9)
        return np.asarray(np.maximum(later - self.seconds, 0.0))

    @property
    def room(self) -> Floats:
        """(F,) metres of path between the ego's front and the vehicle's rear, 0 where they overlap."""
        return np.maximum(self.other.rear - self.ego.front, 0.0)

    @property
    def meet_s(self) -> Floats:
        """(F,) time until the ego reaches the vehicle: `reach_s`, or sooner where the vehicle comes towards it."""
        closing = np.maximum(self.ego_speed - self.along, 1e-9)
        return np.minimum(self.reach_s, self.room / closing)

    @property
    def pursuit_s(self) -> Floats:
        """(F,) time that the vehicle needs at its speed to where the ego's rear is now; infinite if it stands."""
        room = np.maximum(self.ego.rear - self.other.front, 0.0)
        return np.where(self.along > MOVING_M_S, room / np.maximum(self.along, MOVING_M_S), np.inf)

    @property
    def side_gap(self) -> Floats:
        """(F,) distance from the ego's strip to the vehicle, 0 where it reaches in."""
        return np.maximum(np.maximum(self.other.right, -self.other.left) - self.half_width, 0.0)

    @property
    def acceleration(self) -> Floats:
        """(F,) change of the speed along the path over the second around each frame, m/s^2."""
        if len(self.seconds) < 2:
            return np.zeros(len(self.seconds))
        before, after = (
            np.interp(self.seconds + step, self.seconds, np.arange(len(self.seconds))) for step in (-0.5, 0.5)
        )
        frames = np.arange(len(self.seconds))
        span = np.interp(after, frames, self.seconds) - np.interp(before, frames, self.seconds)
        return np.asarray((np.interp(after, frames, self.along) - np.interp(before, frames, self.along)) / span)


def compute_path_interaction(
    ego: Floats, other: Floats, seconds: Floats, present: Bools, start: int
) -> PathInteraction:
    """Bring two tracks of (T, 5) boxes at (T,) times into the frame of the ego's path, from frame ``start`` on."""
    path, frames = PathFrame.of(ego), slice(start, None)
    placed = Placement.of(path, other[frames], frames)
    ego_velocity, velocity = (_compute_velocity(track[frames], seconds[frames]) for track in (ego, other))
    heading = other[frames, 4] - placed.turn
    return PathInteraction(
        seconds=seconds[frames],
        present=present[frames],
        ego=Placement.of(path, ego[frames], frames),
        other=placed,
        ego_speed=np.hypot(ego_velocity[:, 0], ego_velocity[:, 1]),
        speed=np.hypot(velocity[:, 0], velocity[:, 1]),
        along=velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading),
        gap=np.where(present[frames], box_gap(other[frames], ego[frames]), np.inf),
        half_width=0.5 * float(ego[0, 3]),
    )


def _compute_velocity(boxes: Floats, seconds: Floats) -> Floats:
    """(F, 2) m/s; a single frame stands."""
    if len(boxes) < 2:
        return np.zeros((len(boxes), 2))
    return np.asarray(np.gradient(boxes[:, :2], seconds, axis=0))
