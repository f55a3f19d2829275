"""The physics written as the reference works: one candidate, one frame, one matrix at a time.

Nothing is shared with the fast side but its constants of vehicle and driver. `python -m bench.speed evaluation` times
it.
"""

import math
from dataclasses import dataclass

import numpy as np

from benchmark.dynamics.bicycle import DriverLimits, MotionModel, VehicleState
from benchmark.geometry import Floats

LOOK_AHEAD = 10
TERMINAL_WEIGHT = np.diag([1.0, 10.0])


@dataclass(frozen=True)
class SlowPath:
    """Poses (F + 1, 3), speeds (F,) and curvatures (F,) of one candidate."""

    pose: Floats
    speed: Floats
    curvature: Floats


def slow_simulate(
    waypoints: Floats, state: VehicleState, length_m: float, *, steps: int, model: MotionModel
) -> tuple[Floats, Floats, Floats]:
    """One candidate (16, 2 or more): poses of the centre (S + 1, 3), states (S + 1, 6), commands (S, 2)."""
    path = slow_path(waypoints[:, :2], model)
    x, y, yaw = (float(value) for value in state.pose)
    now = [0.0, 0.0, 0.0, state.speed, state.acceleration, state.steering]
    local, commands = [list(now)], []
    for step in range(steps):
        command = slow_commands(path, step, now, state.speed, length_m, model)
        now = slow_step(now, *command, length_m, model)
        local.append(now)
        commands.append(command)
    states, center = [], []
    for ahead, left, turn, *rest in local:
        there = (
            x + ahead * math.cos(yaw) - left * math.sin(yaw),
            y + ahead * math.sin(yaw) + left * math.cos(yaw),
            wrap(turn + yaw),
        )
        states.append([*there, *rest])
        to_center = 0.3 * length_m
        center.append([there[0] + to_center * math.cos(there[2]), there[1] + to_center * math.sin(there[2]), there[2]])
    return np.array(center), np.array(states), np.array(commands)


def wrap(angle: float) -> float:
    """To [-pi, pi)."""
    return angle if -math.pi <= angle < math.pi else (angle + math.pi) % (2.0 * math.pi) - math.pi


def slow_path(waypoints: Floats, model: MotionModel) -> SlowPath:
    """What the tracker follows, by interpolation and two dense least squares."""
    knots = np.concatenate([np.zeros((1, 2)), waypoints])
    at = np.arange(16 * model.frames_per_waypoint + 1) / model.frames_per_waypoint
    if model.smooth:
        from scipy.interpolate import CubicSpline

        points = np.asarray(CubicSpline(np.arange(17.0), knots, bc_type="natural")(at))
    else:
        points = np.column_stack([np.interp(at, np.arange(17.0), column) for column in knots.T])
    headings = slow_headings(points, model)
    along, turns = [], []
    for (x, y), (next_x, next_y), heading, following in zip(points, points[1:], headings, headings[1:]):
        forward = (next_x - x) * math.cos(heading) + (next_y - y) * math.sin(heading)
        along.append(max(forward, 0.0) if model.smooth else forward)
        turns.append(wrap(following - heading))
    frames = len(along)
    acceleration = np.diff(np.eye(frames), axis=0) / model.dt
    jerk = np.diff(np.eye(frames - 1), axis=0) / model.dt
    if not model.smooth:
        jerk[:-1] = np.eye(frames - 1)[: frames - 2][:-1]
    speed = fit(model.dt * np.eye(frames), 1e-4, jerk @ acceleration, np.array(along))
    change = np.diff(np.eye(frames), axis=0) / model.dt
    first = math.sqrt(1e-10 / 1e-2) * np.eye(frames)[:1]
    curvature = fit(np.diag(speed * model.dt), 1e-2, np.concatenate([first, change]), np.array(turns))
    return SlowPath(np.column_stack([points, headings]), speed, curvature)


def fit(design: Floats, weight: float, penalised: Floats, target: Floats) -> Floats:
    """Minimise |target - design x|^2 + weight |penalised x|^2 through a pseudo-inverse, as the reference does."""
    return np.asarray(np.linalg.pinv(design.T @ design + weight * penalised.T @ penalised) @ design.T @ target)


def slow_headings(points: Floats, model: MotionModel) -> list[float]:
    """Direction from the previous to the next point; the smooth model does not believe all of them."""
    inner, held = [], 0.0
    for (before_x, before_y), (after_x, after_y) in zip(points, points[2:]):
        direction = math.atan2(after_y - before_y, after_x - before_x)
        distance = math.hypot(after_x - before_x, after_y - before_y)
        believed = distance >= 2.0 * 0.3 * model.dt and math.cos(direction - held) > 0.0
        held = direction if believed or not model.smooth else held
        inner.append(held)
    return [inner[0], *inner, inner[-1]]


def slow_commands(
    path: SlowPath, step: int, now: list[float], start_speed: float, length_m: float, model: MotionModel
) -> tuple[float, float]:
    """Acceleration and steering rate that the tracker asks for."""
    dt, (x, y, yaw, speed, _, steering) = model.dt, now
    ahead = min(step + LOOK_AHEAD, len(path.speed) - 1)
    wanted = float(path.speed[ahead])
    if model.limits is not None:
        wanted = min(max(wanted, 0.0), max(model.limits.speed_m_s, start_speed))
    if wanted <= 0.2 and speed <= 0.2:
        return -0.5 * (speed - wanted), 0.0
    span = LOOK_AHEAD * dt
    acceleration = -(10.0 * span) / (10.0 * span * span + 1.0) * (speed - wanted)
    path_x, path_y, path_yaw = path.pose[step]
    lateral = -(x - path_x) * math.sin(path_yaw) + (y - path_y) * math.cos(path_yaw)
    curvatures = [float(path.curvature[min(step + number, ahead)]) for number in range(LOOK_AHEAD)]
    wheelbase = model.tracker_wheelbase_m or 0.6 * length_m
    speeds = [speed + acceleration * dt * number for number in range(LOOK_AHEAD)]
    free = roll_out([lateral, wrap(yaw - path_yaw), steering], speeds, curvatures, 0.0, wheelbase, dt)
    unit = roll_out([0.0, 0.0, 0.0], speeds, [0.0] * LOOK_AHEAD, 1.0, wheelbase, dt)
    error, response = np.array([free[0], wrap(free[1])]), np.array(unit[:2])
    rate = -(response @ TERMINAL_WEIGHT @ error) / (response @ TERMINAL_WEIGHT @ response + 1.0)
    return acceleration, float(rate)


def roll_out(
    error: list[float], speeds: list[float], curvatures: list[float], rate: float, wheelbase: float, dt: float
) -> list[float]:
    """The linear model of lateral error, heading error and steering angle over the look-ahead."""
    for speed, curvature in zip(speeds, curvatures, strict=True):
        lateral, heading, steering = error
        error = [
            lateral + speed * dt * heading,
            heading + speed * dt * (steering / wheelbase - curvature),
            steering + dt * rate,
        ]
    return error


def slow_step(now: list[float], acceleration: float, rate: float, length_m: float, model: MotionModel) -> list[float]:
    """Actuators and bicycle, explicit Euler."""
    dt, (x, y, yaw, speed, old_acceleration, steering) = model.dt, now
    wheelbase = 0.6 * length_m
    new_acceleration = old_acceleration + dt / (dt + 0.2) * (acceleration - old_acceleration)
    rate = rate * dt / (dt + 0.05)
    limits = model.limits
    if limits is None:
        new_speed = speed + new_acceleration * dt
        angle = clip(steering + rate * dt, -math.pi / 3, math.pi / 3)
    else:
        most = limits.jerk_m_s3 * dt
        new_acceleration = clip(new_acceleration, old_acceleration - most, old_acceleration + most)
        new_acceleration = clip(new_acceleration, -limits.braking_m_s2, limits.acceleration_m_s2)
        new_speed = speed + new_acceleration * dt
        if new_speed <= 0.0:
            new_speed, new_acceleration = 0.0, max(new_acceleration, 0.0)
        angle = limited_angle(steering, rate, new_speed, wheelbase, dt, limits)
    return [
        x + speed * math.cos(yaw) * dt,
        y + speed * math.sin(yaw) * dt,
        wrap(yaw + speed * math.tan(steering) / wheelbase * dt),
        new_speed,
        new_acceleration,
        angle,
    ]


def limited_angle(
    steering: float, rate: float, speed: float, wheelbase: float, dt: float, limits: DriverLimits
) -> float:
    """Steering angle after one frame of a driver and tyres with limits."""
    fast = max(speed, 0.1)
    most_rate = min(limits.steering_rate_rad_s, limits.lateral_jerk_m_s3 * wheelbase / fast**2)
    most_curvature = min(limits.lateral_acceleration_m_s2 / fast**2, limits.yaw_rate_rad_s / fast)
    most_angle = min(limits.steering_rad, math.atan(most_curvature * wheelbase))
    return clip(steering + clip(rate, -most_rate, most_rate) * dt, -most_angle, most_angle)


def clip(value: float, low: float, high: float) -> float:
    """Into an interval."""
    return min(max(value, low), high)
