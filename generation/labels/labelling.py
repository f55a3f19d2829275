"""Labels of an adversary: kind of manoeuvre, closest approach, side, times, place."""

from enum import StrEnum

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats, box_gap, boxes_overlap, to_local
from benchmark.metrics.places import classify_place
from benchmark.records.attempts import ClosestApproach, ManoeuvreLabels, TimeToCollision
from benchmark.scene import Scene
from generation.labels.interactions import compute_path_interaction
from generation.labels.manoeuvres import find_encroachment, find_occurrences

TIME_TO_COLLISION_LIMIT_S = 5.0
TIME_TO_COLLISION_STEP_S = 0.1


class Side(StrEnum):
    """Side of the ego on which the other vehicle is."""

    FRONT = "front"
    REAR = "rear"
    LEFT = "left"
    RIGHT = "right"


def compute_labels(scene: Scene, agent: int, start: int) -> ManoeuvreLabels:
    """Labels of what a vehicle does to the ego from its launch on, from which it must be there on a finite track."""
    if not (0 <= agent < len(scene.agents) and 0 <= start < len(scene.timestamps_us)):
        raise InputError(
            f"{scene.name} has {len(scene.agents)} agents and {len(scene.timestamps_us)} frames; there is no agent "
            f"{agent} from frame {start} on to label; choose one that exists"
        )
    present, boxes = scene.agents.valid[agent], read_agent_boxes(scene, agent)
    if not present[start:].any() or not np.isfinite(boxes).all():
        raise InputError(
            f"{scene.name}: agent {scene.agents.ids[agent]} is absent from frame {start} on, or its track is not "
            "finite; label another one"
        )
    # While the vehicle is absent, its box is the nearest valid one and would count as standing.
    frames = start + np.flatnonzero(present[start:])
    interaction = compute_path_interaction(scene.ego.boxes, boxes, scene.seconds, present, start)
    closest = find_closest_approach(scene, agent, start)
    times = compute_times_to_collision(scene, agent, start)[frames - start]
    soonest = int(np.argmin(times))
    reached: TimeToCollision | None = None
    if np.isfinite(times[soonest]):
        reached = TimeToCollision(seconds=float(times[soonest]), time_s=float(scene.seconds[frames[soonest]]))
    occurred = find_occurrences(interaction)
    return ManoeuvreLabels(
        manoeuvre=occurred[0].kind,
        occurred=occurred,
        closest_approach=closest,
        time_to_collision=reached,
        encroachment=find_encroachment(interaction),
        place=classify_place(scene.road_map, scene.ego.boxes[closest.frame], boxes[closest.frame]),
    )


def find_closest_approach(scene: Scene, agent: int, start: int) -> ClosestApproach:
    """First closest approach of an agent to the ego's body from a frame on, while the agent is there."""
    gaps = np.where(scene.agents.valid[agent, start:], compute_body_gaps(scene, agent, start), np.inf)
    frame = start + int(np.argmin(gaps))
    return ClosestApproach(
        gap_m=float(gaps.min()),
        frame=frame,
        time_s=float(scene.seconds[frame]),
        side=find_side(scene.ego.boxes[frame], read_agent_boxes(scene, agent)[frame]),
    )


def read_agent_boxes(scene: Scene, agent: int) -> Floats:
    """(T, 5) boxes of one agent."""
    agents = scene.agents
    size = np.broadcast_to(agents.size[agent, :2], (agents.yaw.shape[1], 2))
    return np.concatenate([agents.position[agent, :, :2], size, agents.yaw[agent, :, None]], axis=-1)


def compute_body_gaps(scene: Scene, agent: int, start: int) -> Floats:
    """(T - start,) distances between the bodies of an agent and of the ego, metres."""
    return box_gap(read_agent_boxes(scene, agent)[start:], scene.ego.boxes[start:])


def compute_ego_speed(scene: Scene) -> Floats:
    """(T,) speed of the recorded ego, m/s."""
    velocity = np.gradient(scene.ego.position[:, :2], scene.seconds, axis=0)
    return np.asarray(np.hypot(velocity[:, 0], velocity[:, 1]))


def find_side(ego: Floats, other: Floats) -> Side:
    """Side of the ego on which another (5,) box's centre lies: the diagonals of the ego's body divide the sides."""
    local = to_local(other[:2], ego[[0, 1, 4]])
    along, across = local[0] / ego[2], local[1] / ego[3]
    if abs(along) >= abs(across):
        return Side.FRONT if along >= 0 else Side.REAR
    return Side.LEFT if across > 0 else Side.RIGHT


def compute_times_to_collision(scene: Scene, agent: int, start: int) -> Floats:
    """(T - start,) seconds in steps of 0.1 s until contact at steady velocity and heading; infinity beyond 5 s."""
    own, ego = read_agent_boxes(scene, agent)[start:], scene.ego.boxes[start:]
    seconds = scene.seconds[start:]
    if len(own) < 2:
        return np.full(len(own), np.inf)
    ahead = np.arange(round(TIME_TO_COLLISION_LIMIT_S / TIME_TO_COLLISION_STEP_S) + 1) * TIME_TO_COLLISION_STEP_S
    contact = boxes_overlap(_extrapolate(own, seconds, ahead), _extrapolate(ego, seconds, ahead))
    return np.where(contact.any(axis=1), ahead[np.argmax(contact, axis=1)], np.inf)


def _extrapolate(boxes: Floats, seconds: Floats, ahead: Floats) -> Floats:
    """(T, A, 5) boxes moved on with their velocity."""
    velocity = np.gradient(boxes[:, :2], seconds, axis=0)
    moved = np.repeat(boxes[:, None], len(ahead), axis=1)
    moved[..., :2] += velocity[:, None] * ahead[:, None]
    return moved
