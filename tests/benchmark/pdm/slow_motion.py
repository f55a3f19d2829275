"""From a plan to the motion of a car, as obviously as possible: one step after the other (`docs/pdm.md`)."""

import math

import numpy as np

from benchmark.geometry import Floats

TRACKER_WHEELBASE = 3.089


def wrap(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi


def slow_poses(plan: Floats, now: Floats) -> Floats:
    """The 31 global poses of a plan."""
    x, y, heading = now[:3]
    cos, sin, knots = math.cos(heading), math.sin(heading), [(x, y, heading)]
    for ahead, left, turn in plan:
        knots.append((x + ahead * cos - left * sin, y + ahead * sin + left * cos, heading + turn))
    poses = []
    for state in range(31):
        first = min(state // 5, 5)
        share = (state - 5 * first) / 5.0
        a, b = knots[first], knots[first + 1]
        between = wrap(a[2] + share * wrap(b[2] - a[2]))
        poses.append((a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), between))
    return np.array(poses)


def slow_profiles(poses: Floats) -> tuple[Floats, Floats]:
    """Speeds and curvatures: stacked least squares in (v_0, a_0 .. a_28) and (k_0, r_0 .. r_28)."""
    dt = 0.1
    along = [
        (poses[i + 1][0] - poses[i][0]) * math.cos(poses[i][2])
        + (poses[i + 1][1] - poses[i][1]) * math.sin(poses[i][2])
        for i in range(30)
    ]
    integral = np.array([[1.0] + [dt if j < i else 0.0 for j in range(29)] for i in range(30)])
    rows, wanted = [dt * integral], [np.array(along)]
    for j in range(27):
        rows.append(math.sqrt(1e-4) * np.eye(30)[j + 1 : j + 2])
        wanted.append(np.zeros(1))
    rows.append(math.sqrt(1e-4) * (np.eye(30)[29:30] - np.eye(30)[28:29]))
    wanted.append(np.zeros(1))
    speed = integral @ np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    turns = np.array([wrap(poses[i + 1][2] - poses[i][2]) for i in range(30)])
    penalty = np.diag([math.sqrt(1e-10)] + 29 * [math.sqrt(1e-2)])
    system = np.concatenate([dt * speed[:, None] * integral, penalty])
    curvature = integral @ np.linalg.lstsq(system, np.concatenate([turns, np.zeros(30)]), rcond=None)[0]
    return speed, curvature


def slow_motion(plan: Floats, now: Floats, wheelbase: float = TRACKER_WHEELBASE) -> Floats:
    """The 31 states of a car that follows a plan."""
    poses = slow_poses(plan, now)
    speed, curvature = slow_profiles(poses)
    state = [float(value) for value in now]
    states = [list(state)]
    for k in range(30):
        acceleration, u = slow_command(state, poses[k], speed, curvature, k)
        x, y, heading, v_x, _, a_x, _, delta, _, w, _ = state
        a_new = a_x + (acceleration - a_x) / 3.0
        rate = 2.0 / 3.0 * u
        v_new = v_x + 0.1 * a_new
        delta_new = min(max(delta + 0.1 * rate, -math.pi / 3), math.pi / 3)
        w_new = v_new * math.tan(delta_new) / wheelbase
        state = [
            x + 0.1 * v_x * math.cos(heading), y + 0.1 * v_x * math.sin(heading),
            wrap(heading + 0.1 * v_x * math.tan(delta) / wheelbase),
            v_new, 0.0, a_new, 0.0, delta_new, rate, w_new, (w_new - w) / 0.1,
        ]  # fmt: skip
        states.append(list(state))
    return np.array(states)


def slow_command(state: list[float], pose: Floats, speed: Floats, curvature: Floats, k: int) -> tuple[float, float]:
    x, y, heading, v_x = state[:4]
    j = min(k + 10, 29)
    if speed[j] <= 0.2 and v_x <= 0.2:
        return -0.5 * (v_x - speed[j]), 0.0
    acceleration = -10.0 / 11.0 * (v_x - speed[j])
    bends = [curvature[min(k + n, j)] for n in range(10)]
    free = [-(x - pose[0]) * math.sin(pose[2]) + (y - pose[1]) * math.cos(pose[2]), wrap(heading - pose[2]), state[7]]
    unit = [0.0, 0.0, 0.0]
    for n in range(10):
        v = v_x + n * 0.1 * acceleration
        free = [free[0] + 0.1 * v * free[1], free[1] + 0.1 * v * (free[2] / TRACKER_WHEELBASE - bends[n]), free[2]]
        unit = [unit[0] + 0.1 * v * unit[1], unit[1] + 0.1 * v * unit[2] / TRACKER_WHEELBASE, unit[2] + 0.1]
    free[1] = math.atan2(math.sin(free[1]), math.cos(free[1]))
    u = -(unit[0] * free[0] + 10 * unit[1] * free[1]) / (unit[0] ** 2 + 10 * unit[1] ** 2 + 1)
    return acceleration, u


def slow_direct(plan: Floats, now: Floats) -> Floats:
    """A plan as states without a tracker: central differences of its poses, one-sided at the ends."""
    poses = slow_poses(plan, now)
    x_y, heading = poses[:, :2], np.unwrap(poses[:, 2])
    velocity = np.gradient(x_y, 0.1, axis=0)
    acceleration = np.gradient(velocity, 0.1, axis=0)
    turn = np.gradient(heading, 0.1)
    states = np.zeros((31, 11))
    states[:, :3] = poses
    for first, values in ((3, velocity), (5, acceleration)):
        states[:, first] = values[:, 0] * np.cos(heading) + values[:, 1] * np.sin(heading)
        states[:, first + 1] = -values[:, 0] * np.sin(heading) + values[:, 1] * np.cos(heading)
    states[:, 9], states[:, 10] = turn, np.gradient(turn, 0.1)
    return states
