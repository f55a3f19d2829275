"""Rules that an adversary keeps who knows motion only: it stays on the road, and is only where a careful human copes.

Such an adversary meets egos in other simulators, of which nothing else is known. A plan and its ending keep all corners
of its body on the road. It may come into the ego's way only where a careful human in the ego's place, with the ego's
speed, touches nobody from the planning frame on: neither it, nor another because of it; also if the ego begins to turn
where there is road. Where no motion is like that it keeps clear of the ego as expected, as long as it can.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
import shapely
from shapely.geometry import MultiPolygon

from benchmark.dynamics.bicycle import SimulatedMotion
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.careful_driver import LOOK_FRAMES, CarefulDriverCheck
from generation.extensions.reactive_adversary.returning import build_returns
from generation.extensions.reactive_adversary.safe_endings import SurroundingTracks

_CELL_M: Final = 0.25
_AROUND_M: Final = 40.0
_MOST_M: Final = 250.0
"""Half the side of the square of the road that is known."""
_EDGE_M: Final = 0.15
"""Of road that is left on every side of the body: the road is known to a cell."""
_EVERY_FRAMES: Final = 3
RETURN_FRAMES: Final = 36
"""Until a body that is off the road is to be on it again: 3 s."""


def rasterise_road(scene: Scene) -> DrivableRaster:
    """The road around all that moves in a scene."""
    known = scene.agents.position[scene.agents.valid][:, :2]
    places = np.concatenate([known, scene.ego.position[:1, :2]])
    low, high = places.min(axis=0), places.max(axis=0)
    half = min(0.5 * float((high - low).max()) + _AROUND_M, _MOST_M)
    middle = 0.5 * (low + high) if half < _MOST_M else scene.ego.position[0, :2]
    return DrivableRaster.around(
        scene.road_map, np.array([*middle, 0.0]), half_extent_m=round(half), resolution_m=_CELL_M
    )


@dataclass(frozen=True, slots=True)
class AdversaryRules:
    """The rules at a planning frame, of a body of (2,) ``size``, which is to be on the road from some frame on.

    ``careful`` are humans in the place of an ego that drives as expected, first, and of one that turns; ``recorded`` is
    (K + 1, 3) the adversary's own recording from now on, if it may be known; ``air_m`` is left to the road's edge.
    """

    road: DrivableRaster
    area: MultiPolygon
    from_frame: int
    careful: tuple[CarefulDriverCheck, ...]
    size: Floats
    recorded: Floats | None = None
    air_m: float = 0.0

    @classmethod
    def of(
        cls,
        scene: Scene,
        road: DrivableRaster,
        careful: Sequence[CarefulDriverCheck],
        agent: int,
        now: Floats,
        recorded: Floats | None = None,
    ) -> Self:
        """Rules for an adversary at a (3,) pose; one that is off the road has some time to return to it."""
        for air_m in (_EDGE_M, 0.0):
            known = cls(
                road, scene.road_map.drivable_area, 0, tuple(careful), scene.agents.size[agent, :2], recorded, air_m
            )
            if known.are_on_road(now[:, None, None])[0]:
                return known
        return replace(known, from_frame=RETURN_FRAMES)

    def are_on_road(self, columns: Floats) -> Bools:
        """(P,) whether all corners stay on the road; (3, P, K) x, y, yaw, looked at every 0.25 s and at the end."""
        if columns.shape[2] <= self.from_frame:
            return np.ones(columns.shape[1], np.bool_)
        return np.asarray(self._look(columns, self.from_frame).all(axis=1))

    def measure_off_road(self, columns: Floats) -> Floats:
        """(P,) how many looked-at frames of the first 3 s are off the road; how far it is at their end decides ties."""
        first = columns[:, :, : RETURN_FRAMES + 1]
        off = (~self._look(first, 0)).sum(axis=1)
        away = shapely.distance(shapely.points(first[:2, :, -1].T), self.area)
        return np.asarray(off + away / _MOST_M)

    def _look(self, columns: Floats, first: int) -> Bools:
        """(P, K) whether all corners are on the road, every 0.25 s from a frame on, and at the end."""
        last = columns.shape[2] - 1
        frames = np.unique([*range(first, last + 1, _EVERY_FRAMES), last])
        x, y, yaw = columns[:, :, frames]
        size = np.broadcast_to(self.size + 2.0 * self.air_m, (*x.shape, 2))
        corners = box_corners(np.concatenate([x[..., None], y[..., None], size, yaw[..., None]], axis=-1))
        return np.asarray(self.road.look_up(corners).all(axis=2))

    def are_fair(self, center: Floats) -> Bools:
        """(N,) whether a careful human touches nobody, or the ego never meets it; (N, F, 3) poses from now on."""
        fair, center = np.ones(len(center), np.bool_), center[:, : LOOK_FRAMES + 1]
        for careful in self.careful:
            rows = np.flatnonzero(fair)
            if not len(rows):
                break
            none = np.zeros((len(rows), 0, 6)), np.zeros((len(rows), 0, 2))
            placed = careful.place(SimulatedMotion(center[rows], *none, fair[rows]), self.size)
            fair[rows] = ~careful.hits(placed)
            if careful.lost:
                # Others hit the human in any case: then it may not be met at all.
                fair[rows] &= ~careful.is_met(placed, in_front=False)
        return fair

    @property
    def as_expected(self) -> Self:
        """The same where the ego drives as expected, and never turns."""
        return replace(self, careful=self.careful[:1])

    def are_kept(self, columns: Floats) -> Bools:
        """(P,) whether motions stay on the road and are fair, too; (3, P, K) x, y, yaw."""
        kept = self.are_on_road(columns)
        kept[kept] = self.are_fair(columns[:, kept].transpose(1, 2, 0))
        return kept

    def find_return(
        self, around: SurroundingTracks, motions: Floats, executed: int, are_allowed: Callable[[Floats], Bools]
    ) -> tuple[int, Floats] | None:
        """Index of the first of (N, F, 3) motions that can return to the recording, and (K + 1, 3) how it does.

        ``are_allowed`` is `are_kept` or `are_on_road`.
        """
        if self.recorded is None or not len(motions):
            return None
        columns, can = build_returns(motions, executed, self.recorded, around.frame_seconds)
        row, way = np.nonzero(can)
        kept = np.flatnonzero(are_allowed(columns[:, row, way]))
        kept = kept[around.find_clear(columns[:, row[kept], way[kept]], 0)]
        return (int(row[kept[0]]), columns[:, row[kept[0]], way[kept[0]]].T) if len(kept) else None

    def find_kept(self, around: SurroundingTracks, options: Sequence[Floats], *, keeps_to_road: bool) -> Floats | None:
        """The first of some motions, (K + 1, 3) to the last frame, that touches no other and keeps the rules."""
        poses = np.stack(options)
        kept = np.array([around.compute_clear_seconds(each) == np.inf for each in options])
        if keeps_to_road:
            kept &= self.are_on_road(poses.transpose(2, 0, 1))
        kept &= self.are_fair(poses)
        if not kept.any():
            return None
        off = self.measure_off_road(poses.transpose(2, 0, 1))
        return options[int(np.argmin(np.where(kept, off, np.inf)))]

    def find_clearest(self, around: SurroundingTracks, scene: Scene, frame: int, options: Sequence[Floats]) -> Floats:
        """Of those that touch no other, if any, the one that keeps clear of the ego longest, on the road if it can."""
        free = [each for each in options if around.compute_clear_seconds(each) == np.inf] or [*options]
        on_road = self.are_on_road(np.stack(free).transpose(2, 0, 1))
        order = np.argsort(~on_road, kind="stable").tolist()
        return include_ego(around, scene, frame).find_longest(free[row] for row in order)


def include_ego(around: SurroundingTracks, scene: Scene, frame: int) -> SurroundingTracks:
    """The surroundings with the ego, as the scene has it, among them; those who are in its body now are no measure."""
    times = np.minimum(around.seconds + float(scene.seconds[frame]), float(scene.seconds[-1]))
    boxes = ContinuousTracks.of_scene(scene).ego_at(times)
    return around.extend(boxes)
