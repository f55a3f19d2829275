# A network of your own under test: six images and their calibration in, six waypoints out. From this folder,
#
#     challenger-bench eval --model torch_planner:TorchPlanner --split val --split adv
#     challenger-bench eval --model torch_planner:TorchPlanner --checkpoint mine.safetensors --device cuda
#
# Without weights the last layer is zero, so that its plan is constant velocity: replace Network by yours.

from pathlib import Path

import cv2
import numpy as np
import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from benchmark import Observation, Plan, PlanFrame, SceneInfo

CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
WIDTH, HEIGHT = 320, 180
STEPS_S = 0.5 * np.arange(1, 7)


class Network(nn.Module):
    """Six images -> how far each waypoint lies from constant velocity."""

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(3, 32, 5, 4, 2),
            nn.ReLU(),
            nn.Conv2d(32, 64, 5, 4, 2),
            nn.ReLU(),
            nn.AdaptiveAvgPool2d(1),
            nn.Flatten(),
        )
        self.camera = nn.Linear(9 + 3 + 4, 64)  # intrinsic, position, quaternion
        self.command = nn.Embedding(3, 64)
        self.head = nn.Linear(64, 12)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, images: Tensor, calibration: Tensor, command: Tensor) -> Tensor:
        """(6, 3, H, W) images, (6, 16) calibration and the command -> (6, 2) metres ahead and to the left."""
        seen = self.features(images) + self.camera(calibration)
        return self.head(seen.mean(0) + self.command(command)).reshape(6, 2)


class TorchPlanner:
    """The contract: a name, `reset`, `plan`. Arguments that it has are filled from the command line."""

    name = "torch-planner"

    def __init__(self, checkpoint: Path | None = None, device: str | None = None) -> None:
        torch.manual_seed(0)
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self.network = Network().eval().to(self.device)
        if checkpoint is not None:
            self.network.load_state_dict(load_file(checkpoint))

    def reset(self, scene: SceneInfo) -> None:
        """A new scene begins; a planner with a memory forgets it here."""

    @torch.inference_mode()
    def plan(self, observation: Observation) -> Plan:
        """Constant velocity, moved by what the network sees."""
        images, calibration = [], []
        for name in CAMERAS:
            view = observation.views[name]
            pixels = cv2.resize(view.load(), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)  # (H, W, 3) uint8 RGB
            images.append(torch.from_numpy(pixels).permute(2, 0, 1) / 255 - 0.5)
            camera = view.camera.resized(WIDTH, HEIGHT)  # the intrinsic goes with the size
            calibration.append(np.concatenate([camera.intrinsic.ravel() / WIDTH, camera.translation, camera.rotation]))
        moved = self.network(
            torch.stack(images).to(self.device),
            torch.from_numpy(np.stack(calibration)).float().to(self.device),
            torch.tensor(int(observation.command), device=self.device),
        )
        straight = np.column_stack([observation.ego.velocity[0] * STEPS_S, np.zeros(6)])
        return Plan(straight + moved.cpu().numpy(), PlanFrame.EGO)
