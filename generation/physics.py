"""Physics-aware planning simulator: an LQR tracker drives a kinematic bicycle along sampled waypoints.

Paper section 3, "Physics-aware Planning Simulator". Everything is vectorised over candidates. `MotionModel.si` works in
seconds with the vehicle's own wheelbase and with limits that drivers and tyres have; `MotionModel.reference`
repeats the units and quirks of the public reference code (one frame counts as one second, no limits).
"""

from dataclasses import dataclass

import numpy as np

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.geometry import Bools, Floats, to_global
from generation.reference_path import ReferencePath, reference_path, wrapped

REAR_AXLE_BEHIND_CENTER = 0.3
"""Of the vehicle's length."""
WHEELBASE = 0.6
"""Of the vehicle's length."""
LOOK_AHEAD_STEPS = 10
LATERAL_WEIGHT, HEADING_WEIGHT, SPEED_WEIGHT = 1.0, 10.0, 10.0
ACCELERATION_LAG_S, STEERING_LAG_S = 0.2, 0.05
STOPPING_GAIN, STOPPING_SPEED = 0.5, 0.2


@dataclass(frozen=True, slots=True)
class DriverLimits:
    """What a hurried driver on dry asphalt still does.

    nuPlan's comfort bounds describe its expert drivers: 2.4 and -4.05 m/s^2 along, 4.89 m/s^2 across, 0.95 rad/s,
    4.13 m/s^3 along and 8.37 m/s^3 in all. An adversary brakes a little harder.

    Attributes:
        acceleration_m_s2: Largest.
        braking_m_s2: Largest, positive.
        jerk_m_s3: Largest change of acceleration per second.
        lateral_acceleration_m_s2: Largest.
        lateral_jerk_m_s3: Largest change of lateral acceleration per second by steering.
        yaw_rate_rad_s: Largest.
        steering_rate_rad_s: Largest, at the road wheels.
        steering_rad: Largest angle of the road wheels.
        speed_m_s: Largest that is aimed at, unless the vehicle is faster already.
    """

    acceleration_m_s2: float = 2.5
    braking_m_s2: float = 5.0
    jerk_m_s3: float = 6.0
    lateral_acceleration_m_s2: float = 4.0
    lateral_jerk_m_s3: float = 7.0
    yaw_rate_rad_s: float = 0.9
    steering_rate_rad_s: float = 0.6
    steering_rad: float = 0.6
    speed_m_s: float = 17.0


@dataclass(frozen=True, slots=True)
class MotionModel:
    """Units and quirks of the simulation.

    Attributes:
        dt: Time of one frame.
        frames_per_waypoint: Frames between waypoints.
        tracker_wheelbase_m: Wheelbase that the tracker assumes, ``None`` for the vehicle's own.
        smooth: Cubic interpolation of waypoints, held headings and no reversing; else the reference code's.
        limits: Limits of the driver, ``None`` for the reference's steering limit alone.
    """

    dt: float
    frames_per_waypoint: int
    tracker_wheelbase_m: float | None
    smooth: bool
    limits: DriverLimits | None

    @classmethod
    def si(cls, limits: DriverLimits | None = None) -> "MotionModel":
        """Seconds, 12 Hz, own wheelbase, limits of a driver."""
        return cls(1.0 / FRAME_HZ, FRAMES_PER_KEYFRAME, None, True, limits or DriverLimits())

    @classmethod
    def reference(cls) -> "MotionModel":
        """One frame is one second, five frames a waypoint, the tracker believes in a 3.089 m wheelbase, no limits."""
        return cls(1.0, 5, 3.089, False, None)


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Motion of one vehicle now; the point is the rear axle.

    Attributes:
        pose: (3,) x, y, yaw, global.
        speed: m/s along the heading, not negative.
        acceleration: m/s^2 along the heading.
        steering: Angle of the road wheels, radians.
    """

    pose: Floats
    speed: float
    acceleration: float = 0.0
    steering: float = 0.0


@dataclass(frozen=True, slots=True)
class SimulatedMotion:
    """What B candidates do in S frames.

    Attributes:
        center: (B, S + 1, 3) poses of the box centre, global, starting now.
        states: (B, S + 1, 6) rear-axle x, y, yaw (global), speed, acceleration, steering angle.
        commands: (B, S, 2) acceleration and steering rate that the tracker asked for.
        finite: (B,) False where a candidate had NaN or infinity in it or got there; its poses are then not finite.
    """

    center: Floats
    states: Floats
    commands: Floats
    finite: Bools

    def state(self, candidate: int, frame: int) -> VehicleState:
        """State of one candidate after some frames, to go on from."""
        x, y, yaw, speed, acceleration, steering = self.states[candidate, frame]
        return VehicleState(np.array([x, y, yaw]), float(speed), float(acceleration), float(steering))


def rear_axle(center: Floats, length_m: float) -> Floats:
    """Pose of the rear axle from the pose of the box centre.

    Args:
        center: (..., 3) x, y, yaw.
        length_m: Length of the vehicle.

    Returns:
        (..., 3) x, y, yaw.
    """
    back = REAR_AXLE_BEHIND_CENTER * length_m
    x = center[..., 0] - back * np.cos(center[..., 2])
    y = center[..., 1] - back * np.sin(center[..., 2])
    return np.stack([x, y, center[..., 2]], axis=-1)


def simulate(
    waypoints: Floats, state: VehicleState, length_m: float, *, steps: int, model: MotionModel
) -> SimulatedMotion:
    """Drive along waypoints: LQR tracker, actuators and kinematic bicycle.

    Args:
        waypoints: (B, 16, 2 or 3) x, y (heading is ignored) at 2 Hz in the rear-axle frame of ``state``.
        state: Motion now.
        length_m: Length of the vehicle.
        steps: Frames to simulate.
        model: Units and limits.

    Returns:
        The motion. A candidate with NaN or infinity is marked, the others are not disturbed.
    """
    finite = np.isfinite(waypoints).all(axis=(1, 2))
    safe = np.where(finite[:, None, None], waypoints[..., :2], 0.0)
    path = reference_path(safe, dt=model.dt, frames_per_waypoint=model.frames_per_waypoint, smooth=model.smooth)
    if model.limits is not None:
        np.clip(path.speed, 0.0, max(model.limits.speed_m_s, state.speed), out=path.speed)
    local, commands = _drive(path, state, length_m, steps, model)
    finite &= np.isfinite(local).all(axis=(1, 2))
    yaw = local[..., 2] + state.pose[2]
    states = np.concatenate([to_global(local[..., :2], state.pose), wrapped(yaw)[..., None], local[..., 3:]], axis=-1)
    states[~finite] = np.nan
    ahead = REAR_AXLE_BEHIND_CENTER * length_m
    center = states[..., :3].copy()
    center[..., 0] += ahead * np.cos(center[..., 2])
    center[..., 1] += ahead * np.sin(center[..., 2])
    return SimulatedMotion(center, states, commands, finite)


def _drive(
    path: ReferencePath, state: VehicleState, length_m: float, steps: int, model: MotionModel
) -> tuple[Floats, Floats]:
    """Local states (B, steps + 1, 6) and commands (B, steps, 2)."""
    count = len(path.pose)
    wheelbase = WHEELBASE * length_m
    tracker_wheelbase = model.tracker_wheelbase_m or wheelbase
    states = np.zeros((count, steps + 1, 6))
    states[:, 0, 3:] = state.speed, state.acceleration, state.steering
    commands = np.zeros((count, steps, 2))
    dt = model.dt
    for step in range(steps):
        now = states[:, step]
        yaw, speed, acceleration, steering = now[:, 2], now[:, 3], now[:, 4], now[:, 5]
        commands[:, step] = _track(path, step, now, tracker_wheelbase, dt)
        new_acceleration = acceleration + dt / (dt + ACCELERATION_LAG_S) * (commands[:, step, 0] - acceleration)
        steering_rate = commands[:, step, 1] * dt / (dt + STEERING_LAG_S)
        following = states[:, step + 1]
        following[:, 0] = now[:, 0] + speed * np.cos(yaw) * dt
        following[:, 1] = now[:, 1] + speed * np.sin(yaw) * dt
        following[:, 2] = wrapped(yaw + speed * np.tan(steering) / wheelbase * dt)
        if model.limits is None:
            following[:, 3] = speed + new_acceleration * dt
            following[:, 4] = new_acceleration
            following[:, 5] = np.clip(steering + steering_rate * dt, -np.pi / 3, np.pi / 3)
        else:
            following[:, 3:] = _limited(now, new_acceleration, steering_rate, wheelbase, dt, model.limits)
    return states, commands


def _track(path: ReferencePath, step: int, now: Floats, wheelbase: float, dt: float) -> Floats:
    """Commands (B, 2) of one step: acceleration and steering rate."""
    last = path.speed.shape[1] - 1
    ahead = min(step + LOOK_AHEAD_STEPS, last)
    speed, steering = now[:, 3], now[:, 5]
    excess = speed - path.speed[:, ahead]
    span = LOOK_AHEAD_STEPS * dt
    cruising = -(SPEED_WEIGHT * span) / (SPEED_WEIGHT * span**2 + 1.0) * excess

    at = path.pose[:, step]
    dx, dy = now[:, 0] - at[:, 0], now[:, 1] - at[:, 1]
    lateral_error = -dx * np.sin(at[:, 2]) + dy * np.cos(at[:, 2])
    heading_error = wrapped(now[:, 2] - at[:, 2])
    window = np.minimum(np.arange(step, step + LOOK_AHEAD_STEPS), ahead)
    travel = (speed[:, None] + cruising[:, None] * dt * np.arange(LOOK_AHEAD_STEPS)) * dt
    # Free response of the linear model to no steering at all, and response to one unit of steering rate.
    turn = travel * (steering[:, None] / wheelbase - path.curvature[:, window])
    final_turn = np.cumsum(turn, axis=1)
    free_lateral = lateral_error + np.sum(travel * (heading_error[:, None] + final_turn - turn), axis=1)
    free_heading = wrapped(heading_error + final_turn[:, -1])
    unit_turn = travel * (dt * np.arange(LOOK_AHEAD_STEPS)) / wheelbase
    unit_heading = np.cumsum(unit_turn, axis=1)
    unit_lateral = np.sum(travel * (unit_heading - unit_turn), axis=1)
    unit_heading_last = unit_heading[:, -1]
    gain = LATERAL_WEIGHT * unit_lateral**2 + HEADING_WEIGHT * unit_heading_last**2 + 1.0
    steering_rate = -(LATERAL_WEIGHT * unit_lateral * free_lateral + HEADING_WEIGHT * unit_heading_last * free_heading)

    stopping = (path.speed[:, ahead] <= STOPPING_SPEED) & (speed <= STOPPING_SPEED)
    return np.column_stack(
        [np.where(stopping, -STOPPING_GAIN * excess, cruising), np.where(stopping, 0.0, steering_rate / gain)]
    )


def _limited(
    now: Floats, acceleration: Floats, steering_rate: Floats, wheelbase: float, dt: float, limits: DriverLimits
) -> Floats:
    """New speed, acceleration and steering angle (B, 3) of a vehicle that has limits and never reverses."""
    speed, old_acceleration, steering = now[:, 3], now[:, 4], now[:, 5]
    acceleration = np.clip(
        acceleration, old_acceleration - limits.jerk_m_s3 * dt, old_acceleration + limits.jerk_m_s3 * dt
    )
    acceleration = np.clip(acceleration, -limits.braking_m_s2, limits.acceleration_m_s2)
    new_speed = np.maximum(speed + acceleration * dt, 0.0)
    acceleration = np.where(new_speed > 0.0, acceleration, np.maximum(acceleration, 0.0))
    fast = np.maximum(new_speed, 0.1)
    most_rate = np.minimum(limits.steering_rate_rad_s, limits.lateral_jerk_m_s3 * wheelbase / fast**2)
    most_curvature = np.minimum(limits.lateral_acceleration_m_s2 / fast**2, limits.yaw_rate_rad_s / fast)
    most_angle = np.minimum(limits.steering_rad, np.arctan(most_curvature * wheelbase))
    angle = np.clip(steering + np.clip(steering_rate, -most_rate, most_rate) * dt, -most_angle, most_angle)
    return np.column_stack([new_speed, acceleration, angle])
