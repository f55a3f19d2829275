"""``ego-status``: a small network that sees only how the ego moved and the driving command.

Its L2 is close to that of large models: the field's own warning about open-loop numbers (AD-MLP, BEV-Planner).
"""

from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.machine.storage import file_sha256
from benchmark.planning import Command, Observation, Plan, PlanFrame, SceneInfo
from benchmark.untrusted.files import to_one_line
from benchmark.weights.tensors import read_tensors

PAST_STEPS = 4
"""Poses before now that the network sees, half a second apart."""
HIDDEN = 128
FEATURES = 4 * PAST_STEPS + 5 + len(Command)
_WEIGHTS = "ego_status.safetensors"


@dataclass(frozen=True, slots=True)
class EgoStatusInputs:
    """Motion of the ego now and before, for B samples, in the ego frame of each.

    `past` (B, 4, 3) is x, y, yaw at 2.0, 1.5, 1.0, 0.5 s ago, `past_valid` (B, 4); `velocity` (B, 2) m/s,
    `acceleration` (B, 2) m/s^2, `yaw_rate` (B,) rad/s; `command` (B,) 0 right, 1 left, 2 straight.
    """

    past: Floats
    past_valid: Bools
    velocity: Floats
    acceleration: Floats
    yaw_rate: Floats
    command: NDArray[np.int64]

    def features(self) -> torch.Tensor:
        """(B, 24) inputs of the network, all of order one."""
        past = np.where(self.past_valid[..., None], self.past / [10.0, 10.0, 0.5], 0.0)
        parts = [
            past.reshape(len(past), -1),
            self.past_valid.astype(float),
            self.velocity / 10.0,
            self.acceleration / 3.0,
            self.yaw_rate[:, None] / 0.5,
            np.eye(len(Command))[self.command],
        ]
        return torch.from_numpy(np.concatenate(parts, axis=1).astype(np.float32))

    def constant_velocity(self) -> Floats:
        """(B, 6, 2) waypoints straight ahead at the present speed, metres."""
        seconds = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
        ahead = self.velocity[:, :1] * seconds
        return np.stack([ahead, np.zeros_like(ahead)], axis=-1)


class EgoStatusNetwork(torch.nn.Module):
    """Three layers from ego motion to what constant velocity gets wrong."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(FEATURES, HIDDEN),
            torch.nn.GELU(),
            torch.nn.Linear(HIDDEN, HIDDEN),
            torch.nn.GELU(),
            torch.nn.Linear(HIDDEN, 2 * PLAN_STEPS),
        )

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Correction of the constant-velocity plan, (B, 6, 2) metres, from (B, 24) of `EgoStatusInputs.features`."""
        correction: torch.Tensor = self.layers(features)
        return correction.reshape(-1, PLAN_STEPS, 2)


class EgoStatus:
    """Ego motion and command to plan; a `checkpoint` is of ``train ego-status``, by default the packaged one."""

    name = "ego-status"

    def __init__(self, checkpoint: Path | None = None) -> None:
        if checkpoint is None:
            with as_file(files("adapters") / "weights" / _WEIGHTS) as packaged:
                self._load(packaged)
        else:
            self._load(checkpoint)

    def _load(self, path: Path) -> None:
        self._network = EgoStatusNetwork()
        instead = "make them with: challenger-bench train ego-status"
        tensors, _ = read_tensors(path, what="the weights of ego-status from ", instead=instead)
        try:
            self._network.load_state_dict(tensors)
        except RuntimeError as error:
            raise InputError(
                f"{path} does not hold the weights of ego-status ({to_one_line(error)}); {instead}"
            ) from error
        if not all(bool(torch.isfinite(tensor).all()) for tensor in self._network.state_dict().values()):
            raise InputError(f"the weights of ego-status in {path} hold NaN or infinity; {instead}")
        self.weights_sha256 = file_sha256(path)
        self._network.eval()

    def reset(self, scene: SceneInfo) -> None:
        """Nothing is remembered: the observation holds the past."""

    def plan(self, observation: Observation) -> Plan:
        """Waypoints of the rear axle from ego motion and command, ego frame; images are not looked at."""
        motion = read_ego_status(observation)
        with torch.inference_mode():
            correction = self._network(motion.features())[0].double().numpy()
        return Plan(motion.constant_velocity()[0] + correction, PlanFrame.EGO)


def read_ego_status(observation: Observation) -> EgoStatusInputs:
    """Motion of the ego at one sample, a batch of one."""
    known = min(PAST_STEPS, len(observation.past_poses) - 1)
    past, valid = np.zeros((1, PAST_STEPS, 3)), np.zeros((1, PAST_STEPS), dtype=np.bool_)
    if known:
        past_poses = observation.past_poses[-1 - known : -1]
        now = observation.past_poses[-1]
        past[0, -known:] = np.column_stack([to_local(past_poses[:, :2], now), wrap_angle(past_poses[:, 2] - now[2])])
        valid[0, -known:] = observation.past_valid[-1 - known : -1]
    return EgoStatusInputs(
        past=past,
        past_valid=valid,
        velocity=np.asarray(observation.ego.velocity, float)[None],
        acceleration=np.asarray(observation.ego.acceleration, float)[None],
        yaw_rate=np.array([observation.ego.yaw_rate], dtype=float),
        command=np.array([int(observation.command)]),
    )
