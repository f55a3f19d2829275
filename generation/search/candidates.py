"""Which background vehicles may become adversaries, when they launch, and how they move then.

Appendix "The Adv-nuSc Dataset": up to 10 background vehicles that come close to the ego.
"""

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
import shapely

from benchmark.constants import FOUR_WHEELED_CATEGORIES, FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import REFERENCE_STEERING_RAD, WHEELBASE, DriverLimits, VehicleState, rear_axle
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.machine.storage import content_seed
from benchmark.scene import Scene
from generation.labels.labelling import ego_speed
from generation.search.hyperparameters import ChoiceOf, HyperParameters, Launch
from generation.search.reference_rules import CAR, in_reference_canvas, near_on_the_road, reference_launch

STANDING_M_S = 0.3
"""Slower than this a recorded vehicle stands; what its annotation drifts is noise."""
MOST_SLIP_RAD = 0.35
"""Recorded direction of motion and recorded heading may differ by this at the launch."""
FIT_HALF_WINDOW = FRAMES_PER_KEYFRAME
"""Frames on either side from which the motion at the launch is estimated: one keyframe interval."""


class NotTried(StrEnum):
    """Why an object of a scene is not tried as an adversary."""

    NOT_FOUR_WHEELED = "not-a-four-wheeler"
    ALREADY_ADVERSARY = "already-an-adversary"
    NEVER_NEAR = "never-near-the-ego"
    PARKED = "parked"
    OFF_ROAD = "off-the-drivable-area"
    NO_LAUNCH = "no-frame-to-launch-at"
    EGO_STANDS = "ego-stands-after-the-launch"
    NOT_DRAWN = "not-drawn-by-the-seed"
    NO_CAR = "not-a-car"


def draw(scene: Scene, eligible: Sequence[int], hyper: HyperParameters, seed: int) -> tuple[int, ...]:
    """At most ``hyper.candidate_limit`` of the eligible vehicles.

    Args:
        scene: The recorded scene.
        eligible: Agent indices, ascending.
        hyper: Limits.
        seed: Which choice.

    Returns:
        Agent indices, ascending.
    """
    rng = np.random.default_rng(content_seed("candidates", scene.name, scene.token, seed))
    # Weighted draw without replacement: who waits least, with waiting times of rate "weight".
    weight = np.array([staying_share(scene, agent, hyper) for agent in eligible]) ** hyper.staying_preference
    drawn = np.argsort(rng.exponential(size=len(eligible)) / weight, kind="stable")[: hyper.candidate_limit]
    return tuple(sorted(eligible[index] for index in drawn))


def unfit(scene: Scene, agent: int, hyper: HyperParameters) -> NotTried | None:
    """Why an object cannot become an adversary: one can that comes close on the road and launches at a driving ego.

    Args:
        scene: The recorded scene.
        agent: Index of the agent.
        hyper: Limits.

    Returns:
        The first reason, or ``None`` for an eligible vehicle.
    """
    agents = scene.agents
    if agents.categories[agent] not in FOUR_WHEELED_CATEGORIES:
        return NotTried.NOT_FOUR_WHEELED
    if agents.ids[agent] in scene.adversaries:
        return NotTried.ALREADY_ADVERSARY
    return (
        _unfit_as_we_choose(scene, agent, hyper) if hyper.choice is ChoiceOf.OURS else _unfit_as_reference(scene, agent)
    )


def _unfit_as_reference(scene: Scene, agent: int) -> NotTried | None:
    if scene.agents.categories[agent] != CAR:
        return NotTried.NO_CAR
    near, on_road = near_on_the_road(scene, agent)
    if not on_road:
        return NotTried.OFF_ROAD if in_reference_canvas(scene, agent).any() else NotTried.NEVER_NEAR
    if not near:
        return NotTried.NEVER_NEAR
    return None if reference_launch(scene, agent) is not None else NotTried.NO_LAUNCH


def _unfit_as_we_choose(scene: Scene, agent: int, hyper: HyperParameters) -> NotTried | None:
    agents = scene.agents
    canvas = in_canvas(scene, agents.position[agent, :, :2], hyper.half_extent_m) & agents.valid[agent]
    if not canvas.any() or center_distance(scene, agent)[canvas].min() >= hyper.proximity_m:
        return NotTried.NEVER_NEAR
    path = agents.position[agent, agents.valid[agent], :2]
    if not hyper.parked and np.ptp(path, axis=0).max() < hyper.least_motion_m:
        return NotTried.PARKED
    shapely.prepare(scene.road_map.drivable_area)
    if scene.road_map.is_drivable(agents.position[agent, canvas, :2]).mean() < hyper.least_drivable_share:
        return NotTried.OFF_ROAD
    launch = launch_frame(scene, agent, hyper)
    if launch is None:
        return NotTried.NO_LAUNCH
    if not (ego_speed(scene)[launch:] >= hyper.moving_ego_m_s).any():
        return NotTried.EGO_STANDS
    return None


def staying_share(scene: Scene, agent: int, hyper: HyperParameters) -> float:
    """Share of the frames after its launch that an eligible vehicle's recording spends in the area around the ego.

    Args:
        scene: The recorded scene.
        agent: Index of an eligible agent.
        hyper: Size of the area.

    Returns:
        The share, more than 0.
    """
    launch = launch_frame(scene, agent, hyper)
    inside = in_canvas(scene, scene.agents.position[agent, :, :2], hyper.half_extent_m) & scene.agents.valid[agent]
    return float(inside[launch:].mean())


def in_canvas(scene: Scene, points: Floats, half_extent_m: float, *, first: int = 0) -> Bools:
    """Whether points lie in the square around the ego, frame by frame.

    Args:
        scene: The scene.
        points: (F, 2) metres, global, one a frame.
        half_extent_m: Half the side of the square.
        first: Frame of the first point.

    Returns:
        (F,) verdicts.
    """
    local = to_local(points, scene.ego.pose[first : first + len(points)])
    return np.asarray((np.abs(local) <= half_extent_m).all(axis=-1))


def center_distance(scene: Scene, agent: int) -> Floats:
    """Distance (T,) between the box centres of an agent and of the ego, metres."""
    return np.asarray(np.linalg.norm(scene.agents.position[agent, :, :2] - scene.ego.boxes[:, :2], axis=-1))


def launch_frame(scene: Scene, agent: int, hyper: HyperParameters) -> int | None:
    """First frame at which an agent may take over (`hyperparameters.Launch`).

    Args:
        scene: The recorded scene.
        agent: Index of the agent.
        hyper: Which rule, and its limits.

    Returns:
        The frame, or ``None``.
    """
    match hyper.launch:
        case Launch.NEAR:
            return _launch_near(scene, agent, hyper)
        case Launch.REFERENCE:
            return reference_launch(scene, agent)
        case Launch.START:
            inside = in_canvas(scene, scene.agents.position[agent, :, :2], hyper.half_extent_m)
            there = np.flatnonzero(inside & scene.agents.valid[agent])
            last = inside.size - 1 - hyper.shortest_drive_frames
            return int(there[0]) if len(there) and there[0] <= last else None


def _launch_near(scene: Scene, agent: int, hyper: HyperParameters) -> int | None:
    """First frame at which an agent may take over near the ego.

    It has been there for the history, is close enough to the ego, drives forwards without sliding, stands on the
    road, and enough of the scene is left.

    Args:
        scene: The recorded scene.
        agent: Index of the agent.
        hyper: Limits.

    Returns:
        The frame, or ``None``.
    """
    valid = scene.agents.valid[agent]
    seen = np.convolve(valid, np.ones(hyper.history_frames + 1), mode="full")[: len(valid)] > hyper.history_frames
    last = len(valid) - 1 - hyper.shortest_drive_frames
    close = center_distance(scene, agent) < hyper.launch_distance_m
    for frame in np.flatnonzero(seen & close):
        if frame > last:
            return None
        if drives_forward(scene, agent, int(frame)):
            on_road = scene.road_map.is_drivable(scene.agents.position[agent, frame, :2])
            if on_road:
                return int(frame)
    return None


def drives_forward(scene: Scene, agent: int, frame: int) -> bool:
    """Whether recorded motion agrees with recorded heading: standing, or moving where the box points."""
    velocity, _, _ = _motion(scene, agent, frame)
    if np.hypot(*velocity) < STANDING_M_S:
        return True
    slip = wrap_angle(np.arctan2(velocity[1], velocity[0]) - scene.agents.yaw[agent, frame])
    return bool(np.abs(slip) <= MOST_SLIP_RAD)


def initial_state(scene: Scene, agent: int, frame: int, limits: DriverLimits | None) -> VehicleState:
    """Motion of a recorded vehicle at the hand-over, so that the new track goes on where the old one stops.

    Speed is signed along the heading and then not negative (the reference lost the sign: reversing cars shot ahead).

    Args:
        scene: The recorded scene.
        agent: Index of the agent.
        frame: Frame of the hand-over.
        limits: The state is brought inside them; without any, only the steering inside that of the physics.

    Returns:
        State at the rear axle.
    """
    velocity, acceleration, yaw_rate = _motion(scene, agent, frame)
    yaw = float(scene.agents.yaw[agent, frame])
    heading = np.array([np.cos(yaw), np.sin(yaw)])
    length = float(scene.agents.size[agent, 0])
    pose = rear_axle(np.array([*scene.agents.position[agent, frame, :2], yaw]), length)
    speed = max(float(velocity @ heading), 0.0)
    if speed < STANDING_M_S:
        return VehicleState(pose, 0.0)
    if limits is None:
        steering = np.arctan(yaw_rate * WHEELBASE * length / max(speed, 1.0))
        bounded = np.clip(steering, -REFERENCE_STEERING_RAD, REFERENCE_STEERING_RAD)
        return VehicleState(pose, speed, float(acceleration @ heading), float(bounded))
    along = float(np.clip(acceleration @ heading, -limits.braking_m_s2, limits.acceleration_m_s2))
    most = min(limits.lateral_acceleration_m_s2 / speed, limits.yaw_rate_rad_s)
    steering = np.arctan(np.clip(yaw_rate, -most, most) * WHEELBASE * length / max(speed, 1.0))
    return VehicleState(pose, speed, along, float(np.clip(steering, -limits.steering_rad, limits.steering_rad)))


def _motion(scene: Scene, agent: int, frame: int) -> tuple[Floats, Floats, float]:
    """Velocity (2,), acceleration (2,) and yaw rate of the recorded track at a frame, by a local quadratic fit."""
    valid = scene.agents.valid[agent]
    first, last = frame, frame
    while first > max(frame - FIT_HALF_WINDOW, 0) and valid[first - 1]:
        first -= 1
    while last < min(frame + FIT_HALF_WINDOW, len(valid) - 1) and valid[last + 1]:
        last += 1
    time = (np.arange(first, last + 1) - frame) / FRAME_HZ
    if len(time) < 3:
        return np.zeros(2), np.zeros(2), 0.0
    basis = np.column_stack([np.ones_like(time), time, 0.5 * time**2])
    yaw = np.unwrap(scene.agents.yaw[agent, first : last + 1])
    measured = np.column_stack([scene.agents.position[agent, first : last + 1, :2], yaw])
    fit = np.linalg.lstsq(basis, measured - measured[0], rcond=None)[0]
    return fit[1, :2], fit[2, :2], float(fit[1, 2])
