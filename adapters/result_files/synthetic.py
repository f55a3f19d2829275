"""Made-up samples and plans for files of every format, and what each format loses of a plan."""

from typing import Final

import numpy as np

from adapters.result_files.samples import RecordedSamples, rotate
from benchmark.constants import LIDAR_FROM_REAR_AXLE_M, PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Floats, to_local
from benchmark.machine.storage import content_seed, make_token
from benchmark.planning import Plan, PlanFrame

SINGLE_M: Final = 2e-5
"""Error of a plan from single precision and summed offsets."""
TEXT_M: Final = 0.0051
"""Error from rounding to two decimals."""
OMNIDRIVE_M: Final = 0.032
"""Further error of OmniDrive: it writes values that round to 0.01 as zero, and headings rest on short chords."""
GLOBAL_M: Final = 2e-4
"""Error of single precision for global coordinates of some kilometres."""
PRECISION_M: Final = {
    "bev-planner-json": GLOBAL_M, "omnidrive": OMNIDRIVE_M, "opendrivevla": TEXT_M, "gptdriver-text": TEXT_M,
    "opendrivevla-conversation": TEXT_M,
}  # fmt: skip
"""Error of each format, if larger than `SINGLE_M`."""
_KEYFRAMES: Final = 24
_TURNS_RAD: Final = {"left": 0.06, "right": -0.07, "straight": 0.0, "stands": 0.0}


def make_synthetic_samples(lidar_yaw: float = -np.pi / 2) -> RecordedSamples:
    """Four scenes of 24 samples: turning left and right, going straight, standing; two of them at the same time.

    `lidar_yaw` is that of the lidar's axes in the ego frame.
    """
    poses, scenes, times = [], [], []
    for number, (name, turn) in enumerate(_TURNS_RAD.items()):
        heading = 0.4 + turn * np.arange(_KEYFRAMES)
        step = 0.0 if name == "stands" else 4.0
        way = np.cumsum(step * np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
        poses.append(np.column_stack([way + [400.0 * number, 900.0], heading]))
        scenes += [f"scene-{number + 1:04d}"] * _KEYFRAMES
        times.append(1_500_000_000_000_000 + (number // 2) * 60_000_000 + 500_000 * np.arange(_KEYFRAMES))
    pose, count = np.concatenate(poses), len(scenes)
    mount = np.array([LIDAR_FROM_REAR_AXLE_M, 0.0, lidar_yaw])
    lidar = pose.copy()
    lidar[:, :2] += LIDAR_FROM_REAR_AXLE_M * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    within = np.arange(count) % _KEYFRAMES
    steps = np.arange(1, PLAN_STEPS + 1)
    valid = within[:, None] + steps < _KEYFRAMES
    after = np.minimum(np.arange(count)[:, None] + steps, count - 1)
    future = np.stack([rotate(to_local(lidar[after[row], :2], lidar[row]), -lidar_yaw) for row in range(count)])
    timestamps = np.concatenate(times)
    return RecordedSamples(
        name="the made-up samples",
        tokens=tuple(make_token("made up", row) for row in range(count)),
        scenes=tuple(scenes),
        timestamps_us=timestamps,
        ego_pose=pose,
        lidar_in_ego=np.tile(mount, (count, 1)),
        future=np.where(valid[..., None], future, 0.0),
        valid=valid,
        by_time=np.argsort(timestamps, kind="stable"),
        by_table=np.arange(count),
    )


def make_synthetic_plans(samples: RecordedSamples, frame: PlanFrame = PlanFrame.LIDAR) -> dict[int, Plan]:
    """A plan for each sample: what the car will do as if it went on as now, a little aside and faster."""
    generator = np.random.default_rng(content_seed("made-up plans"))
    plans = {}
    for row in range(len(samples.tokens)):
        moving = samples.scenes[row] != "scene-0004"
        speed = generator.uniform(3.0, 9.0) if moving else 0.0
        bend = generator.uniform(-0.1, 0.1)
        times = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
        ahead: Floats = np.stack([bend * speed * times, speed * times], axis=1)
        plans[row] = Plan(ahead if frame is PlanFrame.LIDAR else rotate(ahead, -np.pi / 2), frame)
    return plans
