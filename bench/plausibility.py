"""How driveable the physics makes the same waypoints: the reference's units and quirks, and SI.

Run as ``OMP_NUM_THREADS=1 python bench/plausibility.py``; `docs/physics.md` holds what it prints. The reference is read
as the paper executes it: every simulated frame is one frame at 12 Hz.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import DriverLimits, MotionModel, SimulatedMotion, VehicleState, rear_axle, simulate
from benchmark.dynamics.driver_limits import LIMIT_TOLERANCE, SIDEWAYS_M_S, broken_limit
from benchmark.geometry import Bools, Floats, wrap_angle
from benchmark.machine.workers import single_threaded
from generation.diffusion.prior import TrajectoryPrior, diversify

GOLDEN = Path(__file__).resolve().parents[1] / "tests" / "golden" / "physics" / "physics.npz"
FRAMES = 36
SAMPLES, SAMPLED_SPEEDS_M_S, SAMPLED_SIZE = 128, (0.0, 2.0, 5.0, 8.0, 11.0, 14.0), (4.6, 1.9)
MODELS = {"reference": MotionModel.reference(), "si": MotionModel.si()}


@dataclass(frozen=True, slots=True)
class Task:
    """Waypoints (B, 16, 3) of one vehicle with an initial speed, metres and seconds."""

    waypoints: Floats
    speed: float
    size: tuple[float, float]

    def drive(self, model: MotionModel) -> SimulatedMotion:
        """What a model makes of it; the reference's speeds are per frame."""
        speed = self.speed if model.limits else self.speed / FRAME_HZ
        return simulate(self.waypoints, VehicleState(np.zeros(3), speed), self.size[0], steps=FRAMES, model=model)


@dataclass(frozen=True, slots=True)
class Measured:
    """What B candidates do.

    Attributes:
        magnitudes: (B, frames) by name, from positions at 12 Hz.
        off_waypoints: (B,) metres between the last frame and the waypoint of that time.
        drivable: (B,) whether each passes verification.
    """

    magnitudes: dict[str, Floats]
    off_waypoints: Floats
    drivable: Bools


def golden_tasks() -> list[Task]:
    """Straight, braking, lane changes, turns, U-turns, stops and noise, for eight vehicles."""
    golden = np.load(GOLDEN)
    tasks = []
    for group, row in enumerate(golden["groups"]):
        values = dict(zip(golden["group_columns"], row, strict=True))
        waypoints = golden["waypoints_local"][golden["group"] == group]
        size = (float(values["length"]), float(values["width"]))
        tasks.append(Task(waypoints, float(values["speed_per_step"]) * FRAME_HZ, size))
    return tasks


def sampled_tasks() -> list[Task]:
    """Samples of the packaged prior, diversified as the search does."""
    prior, tasks = TrajectoryPrior.load(), []
    for speed in SAMPLED_SPEEDS_M_S:
        rng = np.random.default_rng(0)
        waypoints = diversify(prior.sample(SAMPLES, np.array([-0.5 * speed, 0.0, 0.0]), rng), rng)
        tasks.append(Task(waypoints, speed, SAMPLED_SIZE))
    return tasks


def measured(tasks: list[Task], model: MotionModel) -> Measured:
    """Finite differences of the rear axle's path."""
    rows: dict[str, list[Floats]] = {}
    drivable, off = [], []
    for task in tasks:
        motion = task.drive(model)
        center, steering = motion.center[motion.finite], motion.states[motion.finite, :, 5]
        axle = rear_axle(center, task.size[0])
        step = np.diff(axle[..., :2], axis=1) * FRAME_HZ
        cos, sin = np.cos(axle[:, :-1, 2]), np.sin(axle[:, :-1, 2])
        along = step[..., 0] * cos + step[..., 1] * sin
        acceleration = np.diff(along, axis=1) * FRAME_HZ
        yaw_rate = wrap_angle(np.diff(axle[..., 2], axis=1)) * FRAME_HZ
        for name, values in (
            ("acceleration, m/s^2", np.maximum(acceleration, 0.0)),
            ("braking, m/s^2", np.maximum(-acceleration, 0.0)),
            ("jerk, m/s^3", np.abs(np.diff(acceleration, axis=1) * FRAME_HZ)),
            ("lateral acceleration, m/s^2", np.abs(yaw_rate * along)),
            ("yaw rate, rad/s", np.abs(yaw_rate)),
            ("steering rate, rad/s", np.abs(np.diff(steering, axis=1) * FRAME_HZ)),
            ("sideways at the rear axle, m/s", np.abs(step[..., 1] * cos - step[..., 0] * sin)),
            ("reversing, m/s", np.maximum(-along, 0.0)),
        ):
            rows.setdefault(name, []).append(values)
        waypoint = task.waypoints[motion.finite, FRAMES // FRAMES_PER_KEYFRAME - 1, :2]
        off.append(np.hypot(*(axle[:, -1, :2] - waypoint).T))
        boxes = np.empty((*center.shape[:2], 5))
        boxes[..., :2], boxes[..., 2:4], boxes[..., 4] = center[..., :2], task.size, center[..., 2]
        drivable += [broken_limit(box, DriverLimits()) is None for box in boxes]
    magnitudes = {name: np.concatenate(values) for name, values in rows.items()}
    return Measured(magnitudes, np.concatenate(off), np.array(drivable))


def limits() -> dict[str, float]:
    """What the table calls beyond, by quantity."""
    most = DriverLimits()
    return {
        "acceleration, m/s^2": most.acceleration_m_s2,
        "braking, m/s^2": most.braking_m_s2,
        "jerk, m/s^3": most.jerk_m_s3,
        "lateral acceleration, m/s^2": most.lateral_acceleration_m_s2,
        "yaw rate, rad/s": most.yaw_rate_rad_s,
        "steering rate, rad/s": most.steering_rate_rad_s,
        "sideways at the rear axle, m/s": SIDEWAYS_M_S,
        "reversing, m/s": SIDEWAYS_M_S,
    }


def table(tasks: list[Task]) -> str:
    """Markdown."""
    both = {name: measured(tasks, model) for name, model in MODELS.items()}
    lines = [
        "| | limit | reference 95 % | 99 % | beyond | si 95 % | 99 % | beyond |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for name, limit in limits().items():
        cells = []
        for result in both.values():
            values = result.magnitudes[name]
            beyond = (values > limit * LIMIT_TOLERANCE).any(axis=1).mean()
            cells += [f"{np.quantile(values, 0.95):.2f}", f"{np.quantile(values, 0.99):.2f}", f"{beyond:.1%}"]
        lines.append(f"| {name} | {limit:g} | {' | '.join(cells)} |")
    passing, off = [], []
    for result in both.values():
        off += [*(f"{np.quantile(result.off_waypoints, share):.2f}" for share in (0.95, 0.99)), ""]
        passing += ["", "", f"{result.drivable.mean():.1%}"]
    lines.append(f"| off the waypoints after {FRAMES / FRAME_HZ:g} s, m | | {' | '.join(off)} |")
    lines.append(f"| passes `verify.broken_limit` | | {' | '.join(passing)} |")
    return "\n".join(lines)


def main() -> None:
    single_threaded()
    golden, samples = golden_tasks(), sampled_tasks()
    print(f"{sum(len(task.waypoints) for task in golden)} synthetic trajectories, {FRAMES} frames:\n")
    print(table(golden))
    speeds = ", ".join(f"{speed:g}" for speed in SAMPLED_SPEEDS_M_S)
    print(f"\n{SAMPLES} samples of the packaged prior, diversified, at each of {speeds} m/s, {FRAMES} frames:\n")
    print(table(samples))


if __name__ == "__main__":
    main()
