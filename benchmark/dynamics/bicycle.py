"""Physics-aware planning simulator: an LQR tracker drives a kinematic bicycle along sampled waypoints.

Paper section 3, "Physics-aware Planning Simulator". Everything is vectorised over candidates. `MotionModel.si` works in
seconds with the vehicle's own wheelbase and with limits that drivers and tyres have; `MotionModel.reference` repeats
the units and quirks of the public reference code (one frame counts as one second, no limits). `find_broken_limit` tells
which limit a 12 Hz track breaks.
"""

from dataclasses import dataclass

import numpy as np

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.dynamics.reference_path import ReferencePath, build_reference_path, wrap_angle_exactly
from benchmark.dynamics.tracker import (
    STOPPING_GAIN,
    STOPPING_SPEED,
    SteeringLaw,
    compute_cruising_gain,
    compute_steering_law,
    find_speeds_ahead,
)
from benchmark.geometry import Bools, Floats, wrap_angle

REAR_AXLE_BEHIND_CENTER = 0.3
"""Of the vehicle's length."""
WHEELBASE = 0.6
"""Of the vehicle's length."""
ACCELERATION_LAG_S, STEERING_LAG_S = 0.2, 0.05
REFERENCE_STEERING_RAD = np.pi / 3
"""The only limit that the reference code has."""


@dataclass(frozen=True, slots=True)
class DriverLimits:
    """Limits of a hurried driver on dry asphalt, all of them positive.

    nuPlan's comfort bounds describe its expert drivers: 2.4 and -4.05 m/s^2 along, 4.89 m/s^2 across, 0.95 rad/s,
    4.13 m/s^3 along and 8.37 m/s^3 in all. An adversary brakes a little harder. The lateral jerk is that by steering,
    steering is that of the road wheels, and the speed is aimed at unless the vehicle is faster already.
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
    """Units and quirks of the simulation; ``dt`` is the time of one frame.

    ``tracker_wheelbase_m`` is ``None`` for the vehicle's own, ``limits`` for the reference's steering limit alone.
    ``smooth`` means cubic interpolation of waypoints, held headings and no reversing; else the reference code's.
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

    The pose is (3,) x, y, yaw, global; speed is m/s along the heading, not negative; steering the angle of the road
    wheels, radians.
    """

    pose: Floats
    speed: float
    acceleration: float = 0.0
    steering: float = 0.0


@dataclass(frozen=True, slots=True)
class SimulatedMotion:
    """Motion of B candidates in S frames.

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


def compute_rear_axle(center: Floats, length_m: float) -> Floats:
    """(..., 3) x, y, yaw of the rear axle from those of the box centre of a vehicle of some length."""
    back = REAR_AXLE_BEHIND_CENTER * length_m
    x = center[..., 0] - back * np.cos(center[..., 2])
    y = center[..., 1] - back * np.sin(center[..., 2])
    return np.stack([x, y, center[..., 2]], axis=-1)


def simulate(
    waypoints: Floats, state: VehicleState, length_m: float, *, steps: int, model: MotionModel
) -> SimulatedMotion:
    """Drive ``steps`` frames along waypoints: LQR tracker, actuators and kinematic bicycle.

    Waypoints are (B, 16, 2 or 3) x, y (heading is ignored) at 2 Hz in the rear-axle frame of ``state``; their path has
    96 frames in SI, 80 as in the reference. A candidate with NaN or infinity is marked, the others are not disturbed.
    """
    finite = np.isfinite(waypoints).all(axis=(1, 2))
    safe = waypoints[..., :2] if finite.all() else np.where(finite[:, None, None], waypoints[..., :2], 0.0)
    # A candidate that overflows is marked below; the others never see it.
    with np.errstate(all="ignore"):
        path = build_reference_path(
            safe, dt=model.dt, frames_per_waypoint=model.frames_per_waypoint, smooth=model.smooth
        )
        motion = np.array([state.speed, state.acceleration, state.steering])[:, None]
        drive = follow_path(path, motion, wheelbase_m=WHEELBASE * length_m, steps=steps, model=model)
        finite &= np.isfinite(drive.states).all(axis=(0, 1))
        states, center = _to_global(drive, state.pose, REAR_AXLE_BEHIND_CENTER * length_m)
    states[..., ~finite] = np.nan
    center[..., ~finite] = np.nan
    return SimulatedMotion(
        center.transpose(2, 0, 1), states.transpose(2, 0, 1), drive.commands.transpose(2, 0, 1), finite
    )


@dataclass(frozen=True, slots=True)
class BicycleMotion:
    """Motion in the local frame, candidates last: every row that a step works on is contiguous.

    ``states`` are (S + 1, 6, B) x, y, yaw (not wrapped), speed, acceleration, steering angle; ``direction`` (S + 1, 2,
    B) cosine and sine of yaw; ``commands`` (S, 2, B) acceleration and steering rate.
    """

    states: Floats
    direction: Floats
    commands: Floats


def follow_path(
    path: ReferencePath, motion: Floats, *, wheelbase_m: float, steps: int, model: MotionModel
) -> BicycleMotion:
    """Track a path in its own frame, from its origin.

    Speeds first, because they do not depend on steering; then the steering law at all frames; then the path. ``motion``
    is (3, 1 or B) speed, acceleration and steering angle now; the wheelbase is the bicycle's, and the tracker's too
    unless the model says otherwise.
    """
    count = path.speed.shape[1]
    drive = BicycleMotion(np.zeros((steps + 1, 6, count)), np.zeros((steps + 1, 2, count)), np.zeros((steps, 2, count)))
    drive.states[0, 3:] = motion
    drive.direction[:, 0] = 1.0
    wanted = find_speeds_ahead(path, steps)
    if model.limits is not None:
        np.clip(wanted, 0.0, np.maximum(model.limits.speed_m_s, motion[0]), out=wanted)
    stopping = _change_speed(drive, wanted, model)
    law = compute_steering_law(
        path,
        drive.states[:-1, 3],
        drive.commands[:, 0],
        stopping,
        wheelbase_m=model.tracker_wheelbase_m or wheelbase_m,
        dt=model.dt,
    )
    _steer(drive, law, wheelbase_m, model)
    return drive


def _change_speed(drive: BicycleMotion, wanted: Floats, model: MotionModel) -> Bools:
    """Fill in speeds, accelerations and their commands; returns (S, B) where the controller for stopping works."""
    limits, count = model.limits, wanted.shape[1]
    bounds = [np.inf] * 3
    if limits is not None:
        bounds = [limits.jerk_m_s3 * model.dt, limits.acceleration_m_s2, limits.braking_m_s2]
    lag_share = model.dt / (model.dt + ACCELERATION_LAG_S)
    # Constants are rows like everything else: arithmetic with a Python number takes twice as long.
    gain, lag, dt, most_change, most, most_braking = (
        np.full(count, value) for value in (compute_cruising_gain(model.dt), lag_share, model.dt, *bounds)
    )
    least_change, least = -most_change, -most_braking
    stopping = wanted <= STOPPING_SPEED
    may_stop = stopping.any(axis=1)
    for step in range(len(wanted)):
        speed, acceleration = drive.states[step, 3:5]
        new_speed, new_acceleration = drive.states[step + 1, 3:5]
        command = drive.commands[step, 0]
        excess = speed - wanted[step]
        np.multiply(excess, gain, out=command)
        if may_stop[step]:
            stopping[step] &= speed <= STOPPING_SPEED
            np.copyto(command, -STOPPING_GAIN * excess, where=stopping[step])
        np.subtract(command, acceleration, out=new_acceleration)
        new_acceleration *= lag
        np.minimum(new_acceleration, most_change, out=new_acceleration)
        np.maximum(new_acceleration, least_change, out=new_acceleration)
        new_acceleration += acceleration
        np.minimum(new_acceleration, most, out=new_acceleration)
        np.maximum(new_acceleration, least, out=new_acceleration)
        np.add(speed, new_acceleration * dt, out=new_speed)
        if limits is not None and np.fmin.reduce(new_speed, initial=np.inf) <= 0.0:
            standing = new_speed <= 0.0
            new_speed[standing] = 0.0
            new_acceleration[standing] = np.maximum(new_acceleration[standing], 0.0)
    return stopping


def _steer(drive: BicycleMotion, law: SteeringLaw, wheelbase: float, model: MotionModel) -> None:
    """Fill in poses, steering angles and their commands."""
    states, direction = drive.states, drive.direction
    travel = states[:-1, 3] * model.dt
    turning = travel / wheelbase
    most_change, most_angle = compute_steering_limits(states[1:, 3], wheelbase, model.limits, model.dt)
    least_change, least_angle = -most_change, -most_angle
    responding = np.full(travel.shape[1], model.dt * model.dt / (model.dt + STEERING_LAG_S))
    for step, (now, following, heading) in enumerate(zip(states, states[1:], direction)):
        np.cos(now[2], out=heading[0])
        np.sin(now[2], out=heading[1])
        rate = law.steering_rate(step, now[:3], now[5])
        drive.commands[step, 1] = rate
        np.multiply(heading, travel[step], out=following[:2])
        np.multiply(np.tan(now[5]), turning[step], out=following[2])
        following[:3] += now[:3]
        angle = following[5]
        np.multiply(rate, responding, out=angle)
        np.minimum(angle, most_change[step], out=angle)
        np.maximum(angle, least_change[step], out=angle)
        angle += now[5]
        np.minimum(angle, most_angle[step], out=angle)
        np.maximum(angle, least_angle[step], out=angle)
    np.cos(states[-1, 2], out=direction[-1, 0])
    np.sin(states[-1, 2], out=direction[-1, 1])


def compute_steering_limits(
    speed: Floats, wheelbase: float, limits: DriverLimits | None, dt: float
) -> tuple[Floats, Floats]:
    """Largest change of the steering angle in one frame and largest angle, radians, at speeds in m/s.

    Without limits of the driver, the reference's steering limit alone.
    """
    if limits is None:
        return np.full_like(speed, np.inf), np.full_like(speed, REFERENCE_STEERING_RAD)
    fast = np.maximum(speed, 0.1)
    most_rate = np.minimum(limits.steering_rate_rad_s, limits.lateral_jerk_m_s3 * wheelbase / fast**2)
    most_curvature = np.minimum(limits.lateral_acceleration_m_s2 / fast**2, limits.yaw_rate_rad_s / fast)
    return most_rate * dt, np.minimum(limits.steering_rad, np.arctan(most_curvature * wheelbase))


def _to_global(drive: BicycleMotion, pose: Floats, ahead_m: float) -> tuple[Floats, Floats]:
    """States (S + 1, 6, B) in the global frame, and poses (S + 1, 3, B) of a point ahead of theirs."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin], [sin, cos]])
    states = drive.states.copy()
    states[:, :2] = turn @ drive.states[:, :2] + pose[:2, None]
    states[:, 2] = wrap_angle_exactly(drive.states[:, 2] + pose[2])
    center = states[:, :3].copy()
    center[:, :2] += ahead_m * (turn @ drive.direction)
    return states, center


LIMIT_TOLERANCE = 1.05
"""Finite differences at 12 Hz overshoot the simulator's own limits by less than this factor."""
SIDEWAYS_M_S = 0.3
"""Sideways speed of the rear axle that an explicit integration step may show in a tight turn."""


def find_broken_limit(
    boxes: Floats, limits: DriverLimits, *, rounded_m: float = 0.0
) -> tuple[str, float, float] | None:
    """First limit of the driver that a 12 Hz track breaks: finite differences of the rear axle's path.

    Name with unit, value and limit, or ``None``; tracks of fewer than three frames break none. ``rounded_m`` is how far
    each position may be from where it was, where a file holds it to a few digits: the limits are wider by what that
    does to the differences.
    """
    if len(boxes) < 3:
        return None
    axle = compute_rear_axle(boxes[:, [0, 1, 4]], float(boxes[0, 2]))
    step = np.diff(axle[:, :2], axis=0) * FRAME_HZ
    yaw = axle[:-1, 2]
    along = step[:, 0] * np.cos(yaw) + step[:, 1] * np.sin(yaw)
    across = step[:, 1] * np.cos(yaw) - step[:, 0] * np.sin(yaw)
    yaw_rate = wrap_angle(np.diff(axle[:, 2])) * FRAME_HZ
    acceleration = np.diff(along) * FRAME_HZ
    sideways = SIDEWAYS_M_S + 2 * rounded_m * FRAME_HZ
    more = 4 * rounded_m * FRAME_HZ**2
    measured = (
        ("speed sideways, m/s", np.abs(across).max(), sideways),
        ("speed backwards, m/s", -along.min(), sideways),
        ("acceleration, m/s^2", acceleration.max(), limits.acceleration_m_s2 * LIMIT_TOLERANCE + more),
        ("braking, m/s^2", -acceleration.min(), limits.braking_m_s2 * LIMIT_TOLERANCE + more),
        ("yaw rate, rad/s", np.abs(yaw_rate).max(), limits.yaw_rate_rad_s * LIMIT_TOLERANCE),
        (
            "lateral acceleration, m/s^2",
            np.abs(yaw_rate * along).max(),
            limits.lateral_acceleration_m_s2 * LIMIT_TOLERANCE,
        ),
    )
    return next(((name, float(value), limit) for name, value, limit in measured if not value <= limit), None)
