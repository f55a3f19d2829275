"""What an adversary does to the ego: kind of manoeuvre, closest approach, side, times, place."""

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats, box_gap, boxes_overlap, to_local
from benchmark.scene import Scene
from generation.labels.encounters import encounter
from generation.labels.manoeuvres import Encroachment, Manoeuvre, Occurrence, encroachment, occurrences
from generation.labels.places import Place, place_of

TIME_TO_COLLISION_LIMIT_S = 5.0
TIME_TO_COLLISION_STEP_S = 0.1


class Side(StrEnum):
    """Where the other vehicle is, seen from the ego."""

    FRONT = "front"
    REAR = "rear"
    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, slots=True)
class ClosestApproach:
    """The moment at which two bodies are closest.

    Attributes:
        gap_m: Distance between the bodies.
        frame: Frame index.
        time_s: Seconds since the first frame.
        side: Side of the ego.
    """

    gap_m: float
    frame: int
    time_s: float
    side: Side


@dataclass(frozen=True, slots=True)
class Labels:
    """What one adversary does to the ego and where; ``docs/manoeuvres.md`` defines every word.

    Attributes:
        manoeuvre: The primary kind.
        occurred: Every kind that occurred, the primary one first.
        closest: Closest approach.
        least_time_to_collision_s: Smallest of `times_to_collision`, ``None`` if never within 5 s.
        time_to_collision_at_s: When it was smallest first, seconds since the first frame.
        encroachment: Closest succession on the same piece of the ego's path, ``None`` if there was none.
        place: Where the closest approach happened.
    """

    manoeuvre: Manoeuvre
    occurred: tuple[Occurrence, ...]
    closest: ClosestApproach
    least_time_to_collision_s: float | None
    time_to_collision_at_s: float | None
    encroachment: Encroachment | None
    place: Place

    def as_json(self) -> dict[str, Any]:
        """The labels as JSON values."""
        reached = self.least_time_to_collision_s
        return {
            "manoeuvre": self.manoeuvre.value,
            "occurred": [{**asdict(item), "kind": item.kind.value} for item in self.occurred],
            "closest_approach": {**asdict(self.closest), "side": self.closest.side.value},
            "time_to_collision": None
            if reached is None
            else {"seconds": reached, "time_s": self.time_to_collision_at_s},
            "encroachment": None if self.encroachment is None else asdict(self.encroachment),
            "place": self.place.value,
        }


def describe(scene: Scene, agent: int, start: int) -> Labels:
    """Say what a vehicle does to the ego.

    Args:
        scene: The scene.
        agent: Index of the vehicle.
        start: First frame that counts, the launch of an adversary.

    Returns:
        The labels.

    Raises:
        InputError: If there is no such vehicle or frame, the vehicle is not there from then on, or its track is not
            finite.
    """
    if not (0 <= agent < len(scene.agents) and 0 <= start < len(scene.timestamps_us)):
        raise InputError(
            f"{scene.name} has {len(scene.agents)} agents and {len(scene.timestamps_us)} frames; there is no agent "
            f"{agent} from frame {start} on to describe"
        )
    present, boxes = scene.agents.valid[agent], agent_boxes(scene, agent)
    if not present[start:].any() or not np.isfinite(boxes).all():
        raise InputError(
            f"{scene.name}: agent {scene.agents.ids[agent]} is not there from frame {start} on or its track is not "
            "finite; describe another one"
        )
    # Where the vehicle is not there, its box is the nearest valid one and would count as standing.
    frames = start + np.flatnonzero(present[start:])
    met = encounter(scene.ego.boxes, boxes, scene.seconds, present, start)
    closest = closest_approach(scene, agent, start)
    times = times_to_collision(scene, agent, start)[frames - start]
    soonest = int(np.argmin(times))
    known = bool(np.isfinite(times[soonest]))
    occurred = occurrences(met)
    return Labels(
        manoeuvre=occurred[0].kind,
        occurred=occurred,
        closest=closest,
        least_time_to_collision_s=float(times[soonest]) if known else None,
        time_to_collision_at_s=float(scene.seconds[frames[soonest]]) if known else None,
        encroachment=encroachment(met),
        place=place_of(scene.road_map, scene.ego.boxes[closest.frame], boxes[closest.frame]),
    )


def closest_approach(scene: Scene, agent: int, start: int) -> ClosestApproach:
    """Closest approach of an agent to the ego's body from a frame on, while the agent is there.

    Args:
        scene: The scene.
        agent: Index of the agent.
        start: First frame that counts.

    Returns:
        The first closest moment.
    """
    gaps = np.where(scene.agents.valid[agent, start:], body_gaps(scene, agent, start), np.inf)
    frame = start + int(np.argmin(gaps))
    return ClosestApproach(
        float(gaps.min()),
        frame,
        float(scene.seconds[frame]),
        side_of(scene.ego.boxes[frame], agent_boxes(scene, agent)[frame]),
    )


def agent_boxes(scene: Scene, agent: int) -> Floats:
    """(T, 5) boxes of one agent."""
    agents = scene.agents
    size = np.broadcast_to(agents.size[agent, :2], (agents.yaw.shape[1], 2))
    return np.concatenate([agents.position[agent, :, :2], size, agents.yaw[agent, :, None]], axis=-1)


def body_gaps(scene: Scene, agent: int, start: int) -> Floats:
    """(T - start,) distances between the bodies of an agent and of the ego, metres."""
    return box_gap(agent_boxes(scene, agent)[start:], scene.ego.boxes[start:])


def ego_speed(scene: Scene) -> Floats:
    """(T,) speed of the recorded ego, m/s."""
    velocity = np.gradient(scene.ego.position[:, :2], scene.seconds, axis=0)
    return np.asarray(np.hypot(velocity[:, 0], velocity[:, 1]))


def side_of(ego: Floats, other: Floats) -> Side:
    """Side of the ego on which another box lies: the diagonals of the ego's body divide the sides.

    Args:
        ego: (5,) box.
        other: (5,) box.

    Returns:
        The side of the other box's centre.
    """
    local = to_local(other[:2], ego[[0, 1, 4]])
    along, across = local[0] / ego[2], local[1] / ego[3]
    if abs(along) >= abs(across):
        return Side.FRONT if along >= 0 else Side.REAR
    return Side.LEFT if across > 0 else Side.RIGHT


def times_to_collision(scene: Scene, agent: int, start: int) -> Floats:
    """Time until contact if, at a frame, both went on with their velocity and heading.

    Args:
        scene: The scene.
        agent: Index of the agent.
        start: First frame that counts.

    Returns:
        (T - start,) seconds in steps of 0.1 s; infinity where there is no contact within 5 s.
    """
    own, ego = agent_boxes(scene, agent)[start:], scene.ego.boxes[start:]
    seconds = scene.seconds[start:]
    if len(own) < 2:
        return np.full(len(own), np.inf)
    ahead = np.arange(round(TIME_TO_COLLISION_LIMIT_S / TIME_TO_COLLISION_STEP_S) + 1) * TIME_TO_COLLISION_STEP_S
    contact = boxes_overlap(_extrapolated(own, seconds, ahead), _extrapolated(ego, seconds, ahead))
    return np.where(contact.any(axis=1), ahead[np.argmax(contact, axis=1)], np.inf)


def _extrapolated(boxes: Floats, seconds: Floats, ahead: Floats) -> Floats:
    """(T, A, 5) boxes moved on with their velocity."""
    velocity = np.gradient(boxes[:, :2], seconds, axis=0)
    moved = np.repeat(boxes[:, None], len(ahead), axis=1)
    moved[..., :2] += velocity[:, None] * ahead[:, None]
    return moved
