"""Where agents are along and across the ego's path, and how they move along and across it.

``docs/severity.md``, "What a driver sees". A place on the path hardly ever depends on where the ego is, so it is found
once for every instant, and again only where the path's nearest point lies outside the stretch around the ego.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats, box_corners
from benchmark.interactions.ego_path import EgoPath
from benchmark.interactions.tracks import ContinuousTracks, Integers

LOOK_BACK_M: Final = 50.0
LOOK_AHEAD_M: Final = 100.0
HORIZON_M: Final = 100.0
"""Agents further away are ignored."""
OUTLINE_REACH_M: Final = 15.0


@dataclass(frozen=True, slots=True)
class PathPlacements:
    """Boxes in the frame of the path; all arrays (Q,) and metres.

    ``station`` and ``offset``, positive on the left, are of the centre, the others of the outline: its lowest and
    highest station and offset.
    """

    station: Floats
    offset: Floats
    rear: Floats
    front: Floats
    right: Floats
    left: Floats


@dataclass(frozen=True, slots=True)
class PathRelations:
    """N agents at K instants, seen from a path: (N, K, 5) boxes, (N, K) presence and places by the whole path.

    ``velocity`` is (N, K, 2), m/s, ``along`` and ``across`` (to the left) are (N, K) of it; ``hides`` are (N,), which
    can hide a car.
    """

    path: EgoPath
    times: Floats
    boxes: Floats
    present: Bools
    velocity: Floats
    hides: Bools
    places: PathPlacements
    along: Floats
    across: Floats

    @classmethod
    def of(cls, path: EgoPath, tracks: ContinuousTracks, times: Floats) -> "PathRelations":
        """Relate all agents to the ego's path at instants of the recording."""
        boxes, present = tracks.agents_at(times)
        velocity = tracks.velocities_at(times)
        shape = present.shape
        # An agent that has not moved since the instant before is where it was.
        moved = np.ones(shape, np.bool_)
        moved[:, 1:] = (boxes[:, 1:] != boxes[:, :-1]).any(axis=-1) | ~present[:, :-1]
        needs_placing = moved & present
        # No driver reverses: an agent behind the whole recording is behind every driver, for any outline.
        placements = place_on_path(path, boxes[needs_placing], outlines_from=float(path.recorded_station(times).min()))
        owner = np.cumsum(needs_placing.ravel()).reshape(shape) - 1
        owner = np.where(present, owner, 0)
        filled = {
            name: getattr(placements, name)[owner] if needs_placing.any() else np.zeros(shape)
            for name in PathPlacements.__dataclass_fields__
        }
        places = PathPlacements(**filled)
        along, across = _split_velocity(path, places.station, velocity)
        return cls(path, times, boxes, present, velocity, tracks.hides, places, along, across)

    @classmethod
    def now(
        cls, path: EgoPath, time: float, boxes: Floats, present: Bools, velocity: Floats, hides: Bools, behind_m: float
    ) -> "PathRelations":
        """Relate (N, 5) agents to a path at the only instant of which anything is known.

        ``hides`` says which can hide a car. No agent behind the station ``behind_m`` matters.
        """
        placements = place_on_path(path, boxes[present], outlines_from=behind_m)
        filled = {name: np.zeros((len(boxes), 1)) for name in PathPlacements.__dataclass_fields__}
        for name, array in filled.items():
            array[present, 0] = getattr(placements, name)
        places = PathPlacements(**filled)
        along, across = _split_velocity(path, places.station, velocity[:, None])
        return cls(
            path, np.array([time]), boxes[:, None], present[:, None], velocity[:, None], hides, places, along, across
        )

    def around(self, instant: int, stations: Floats) -> "RelativeAgents":
        """(R, N) agents as seen at an instant by each of R egos at stations on the path."""
        return self.seen(np.arange(len(self.boxes)), np.array(instant), stations[:, None])

    def seen(self, agents: Integers, instants: Integers, stations: Floats) -> "RelativeAgents":
        """Agents at instants, seen by egos at stations on the path, metres; indices and stations broadcast."""
        eyes = self.path.position(stations)
        agents, instants, stations = np.broadcast_arrays(agents, instants, stations)
        places = {name: getattr(self.places, name)[agents, instants] for name in PathPlacements.__dataclass_fields__}
        along, across = self.along[agents, instants], self.across[agents, instants]
        offset = self.boxes[agents, instants, :2] - eyes
        near = self.present[agents, instants] & (np.hypot(offset[..., 0], offset[..., 1]) <= HORIZON_M)
        low, high = stations - LOOK_BACK_M, stations + LOOK_AHEAD_M
        needs_placing = near & ((places["station"] < low) | (places["station"] > high))
        if needs_placing.any():
            boxes = self.boxes[agents[needs_placing], instants[needs_placing]]
            places["station"][needs_placing], _ = self.path.project(
                boxes[:, :2], low[needs_placing], high[needs_placing]
            )
            # What is behind is ignored, so that only what lies ahead on this stretch is placed again.
            needs_placing &= places["station"] >= stations
        if needs_placing.any():
            agent, instant = agents[needs_placing], instants[needs_placing]
            placements = place_on_path(self.path, self.boxes[agent, instant], low[needs_placing], high[needs_placing])
            for name, array in places.items():
                array[needs_placing] = getattr(placements, name)
            along[needs_placing], across[needs_placing] = _split_velocity(
                self.path, placements.station, self.velocity[agent, instant]
            )
        length, width = self.path.size
        return RelativeAgents(
            ahead=near & (places["station"] >= stations),
            gap=places["rear"] - (stations + 0.5 * length),
            extent=places["front"] - places["rear"],
            side=np.maximum(places["right"], -places["left"]) - 0.5 * width,
            along=along,
            across=across,
            towards=np.where(places["offset"] > 0, -across, across),
        )


@dataclass(frozen=True, slots=True)
class RelativeAgents:
    """Agents as seen by egos, usually (R, N); metres and m/s.

    Attributes:
        ahead: Whether the agent is there, within 100 m, and its centre not behind the ego's.
        gap: From the ego's front to the agent's rear along the path.
        extent: Length of the agent along the path.
        side: Free distance between the ego's strip and the agent; not positive where it is in the way.
        across: Its velocity to the left of the path; ``along`` is along it, ``towards`` towards it.
    """

    ahead: Bools
    gap: Floats
    extent: Floats
    side: Floats
    along: Floats
    across: Floats
    towards: Floats

    def row(self, ego: int) -> "RelativeAgents":
        """The same for one of the egos, (1, N)."""
        return RelativeAgents(
            **{name: getattr(self, name)[ego : ego + 1] for name in RelativeAgents.__dataclass_fields__}
        )


def place_on_path(
    path: EgoPath, boxes: Floats, low: Floats | None = None, high: Floats | None = None, outlines_from: float = -np.inf
) -> PathPlacements:
    """Put (Q, 5) boxes into the frame of a path.

    Centres by the stretch from (Q,) ``low`` to (Q,) ``high`` stations, the whole path by default; outlines (corners and
    middles of the sides) within 15 m of it. Boxes whose centre lies before ``outlines_from`` have no outline.
    """
    station, offset = path.project(boxes[:, :2], low, high)
    rear, front, right, left = station.copy(), station.copy(), offset.copy(), offset.copy()
    rows = np.flatnonzero(station >= outlines_from)
    corners = box_corners(boxes[rows])
    outline = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1, axis=1))], axis=1)
    around = np.repeat(station[rows], outline.shape[1])
    stations, offsets = path.project(outline.reshape(-1, 2), around - OUTLINE_REACH_M, around + OUTLINE_REACH_M)
    stations, offsets = stations.reshape(outline.shape[:2]), offsets.reshape(outline.shape[:2])
    rear[rows], front[rows] = stations.min(axis=1), stations.max(axis=1)
    right[rows], left[rows] = offsets.min(axis=1), offsets.max(axis=1)
    return PathPlacements(station, offset, rear, front, right, left)


def _split_velocity(path: EgoPath, station: Floats, velocity: Floats) -> tuple[Floats, Floats]:
    tangent = path.tangent(station)
    along = velocity[..., 0] * tangent[..., 0] + velocity[..., 1] * tangent[..., 1]
    across = velocity[..., 1] * tangent[..., 0] - velocity[..., 0] * tangent[..., 1]
    return np.asarray(along), np.asarray(across)
