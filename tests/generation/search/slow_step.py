"""One planning step written out: sampling, physics, score, draw, in loops that say what they do.

Shared with the fast side are the network's answer to noisy actions, the rasterised road and the generator of random
numbers; all else is written from the paper, from the description of the reference code, and from `slow_physics`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from benchmark.dynamics.bicycle import MotionModel, VehicleState
from benchmark.geometry import Floats
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.search.hyperparameters import HyperParameters
from generation.search.scoring import ScoringSurroundings
from tests.benchmark.dynamics.slow_physics import slow_simulate
from tests.generation.search.slow_reference_scoring import slow_reference
from tests.generation.search.slow_scoring import slow_final_scores, slow_score_terms

STEPS = 100
BETAS = [(0.01 + (math.sqrt(0.02) - 0.01) * step / (STEPS - 1)) ** 2 for step in range(STEPS)]
ALPHA_BARS = [math.prod(1.0 - beta for beta in BETAS[: step + 1]) for step in range(STEPS)]
ACTION_M = 4.0


@dataclass(frozen=True)
class SlowChoice:
    """What a planning step chooses, and the scores of its rounds."""

    waypoints: Floats
    center: Floats
    index: int
    scores: list[list[float]]


@dataclass(frozen=True)
class SlowStep:
    """A planning step at the frame of the launch, of the reference code or of the paper."""

    scene: Scene
    agent: int
    frame: int
    hyper: HyperParameters
    denoiser: TrajectoryDenoiser
    rng: np.random.Generator
    reference: bool

    def run(self) -> SlowChoice:
        """The whole step, with random numbers asked for in the order of the search."""
        if self.reference:
            # The switch of the challenge, which is never off so soon after the launch.
            self.rng.random()
        waypoints = self.sample()
        if self.reference:
            waypoints = self.varied(waypoints)
        scores: list[list[float]] = []
        for level in (*self.levels(), 0):
            start = self.rng.uniform(0.0, 1e-3, len(waypoints))
            if self.reference:
                start = start + 0.02
            centers = [self.driven(each) for each in waypoints]
            score = self.scored(np.stack(centers), start)
            scores.append(score)
            if level:
                waypoints = self.mutated(waypoints[self.drawn(score)], level)
        index = min(range(len(score)), key=lambda each: score[each])
        return SlowChoice(waypoints[index], centers[index], index, scores)

    def levels(self) -> list[int]:
        """Noise of each round: from 5 down to 1."""
        rounds = self.hyper.rounds
        return [round(5 + (1 - 5) * number / (rounds - 1)) for number in range(rounds)]

    def noise(self, count: int) -> Floats:
        """Standard normal actions, in single precision."""
        return self.rng.standard_normal((count, 16, 3)).astype(np.float32).astype(np.float64)

    def sample(self) -> Floats:
        """From noise by all 100 steps."""
        noise = torch.from_numpy(self.noise(self.hyper.candidates).astype(np.float32))
        with torch.inference_mode():
            actions = self.denoiser.start(noise).numpy().astype(np.float64)
        return self.integrated(self.denoised(actions, STEPS - 1))

    def denoised(self, actions: Floats, first: int) -> Floats:
        """Step by step to the clean sample, each but the last with a little noise."""
        for step in range(first, -1, -1):
            asked = torch.from_numpy(actions.astype(np.float32))
            with torch.inference_mode():
                eps = self.denoiser(asked, torch.tensor([step], dtype=torch.float32)).numpy().astype(np.float64)
            here, there = ALPHA_BARS[step], ALPHA_BARS[step - 1] if step else 1.0
            clean = np.clip((actions - math.sqrt(1.0 - here) * eps) / math.sqrt(here), -1.0, 1.0)
            spread = 0.0
            if step:
                eta = math.sqrt(BETAS[step - 1] / (1.0 - BETAS[step - 1]))
                spread = eta * math.sqrt((1.0 - there) / (1.0 - here) * (1.0 - here / there))
            actions = math.sqrt(there) * clean + math.sqrt(1.0 - there - spread**2) * eps
            if step:
                actions = actions + spread * self.noise(len(actions))
        return actions

    def integrated(self, actions: Floats) -> Floats:
        """Second differences to positions, from the pose half a second ago and the origin."""
        waypoints = np.zeros_like(actions)
        for candidate in range(len(actions)):
            before, now = self.previous(), np.zeros(3)
            for number in range(16):
                before, now = now, 2.0 * now - before + ACTION_M * actions[candidate, number]
                waypoints[candidate, number] = now
        return waypoints

    def mutated(self, waypoints: Floats, level: int) -> Floats:
        """Back to actions, noise on top, and as many steps down again."""
        actions = np.zeros_like(waypoints)
        for candidate in range(len(waypoints)):
            headings = np.unwrap([0.0, *waypoints[candidate, :, 2]])[1:]
            path = [self.previous(), np.zeros(3), *np.column_stack([waypoints[candidate, :, :2], headings])]
            for number in range(16):
                bend = path[number + 2] - 2.0 * path[number + 1] + path[number]
                actions[candidate, number] = bend / ACTION_M
        kept = ALPHA_BARS[level - 1]
        noisy = math.sqrt(kept) * actions + math.sqrt(1.0 - kept) * self.noise(len(actions))
        return self.integrated(self.denoised(noisy, level - 1))

    def varied(self, waypoints: Floats) -> Floats:
        """The reference's quarters."""
        quarter, result = len(waypoints) // 4, waypoints.copy()
        for part, (axes, low, high) in enumerate(((1, 0.2, 0.8), (1, 1.2, 1.8), (2, 0.5, 1.5)), start=1):
            draws = self.rng.random(quarter)
            for number, draw in enumerate(draws):
                result[part * quarter + number, :, :axes] *= low + (high - low) * draw
        return result

    def pose(self, frame: int) -> tuple[float, float, float]:
        """Of the recorded box centre."""
        agents = self.scene.agents
        x, y = agents.position[self.agent, frame, :2].tolist()
        return x, y, float(agents.yaw[self.agent, frame])

    def state(self) -> VehicleState:
        """Rear axle and speed; the vehicles of the tests drive straight at one speed."""
        x, y, yaw = self.pose(self.frame)
        behind = 0.3 * float(self.scene.agents.size[self.agent, 0])
        before = self.pose(self.frame - 2)
        a_frame = math.hypot(x - before[0], y - before[1]) / 2.0
        speed = a_frame if self.reference else a_frame * 12.0
        return VehicleState(np.array([x - behind * math.cos(yaw), y - behind * math.sin(yaw), yaw]), speed)

    def previous(self) -> Floats:
        """Pose half a second ago: six frames; the reference code takes four."""
        x, y, yaw = self.pose(self.frame)
        was_x, was_y, was_yaw = self.pose(self.frame - (4 if self.reference else 6))
        dx, dy = was_x - x, was_y - y
        return np.array(
            [dx * math.cos(yaw) + dy * math.sin(yaw), dy * math.cos(yaw) - dx * math.sin(yaw), was_yaw - yaw]
        )

    def frames(self) -> list[int]:
        """That are scored, counted from the planning frame."""
        left = len(self.scene.timestamps_us) - 1 - self.frame
        if self.reference:
            return [pose for pose in range(81) if pose <= left]
        return [each for each in (self.hyper.timestep_frames * number for number in range(1, 13)) if each <= left]

    def driven(self, waypoints: Floats) -> Floats:
        """Poses (S, 3) of the box centre at the frames that are scored."""
        model = MotionModel.reference() if self.reference else replace(MotionModel.si(), limits=None)
        length, at = float(self.scene.agents.size[self.agent, 0]), self.frames()
        center, _, _ = slow_simulate(waypoints, self.state(), length, steps=at[-1], model=model)
        return center[at]

    def scored(self, centers: Floats, start: Floats) -> list[float]:
        """Final scores of (B, S, 3) poses."""
        around, size = self.around(), self.scene.agents.size[self.agent, :2]
        if not self.reference:
            terms = slow_score_terms(centers, size, around, self.hyper)
            return slow_final_scores(terms, start, self.hyper)
        pose = around.raster.pose
        cos, sin = math.cos(pose[2]) / 0.5, math.sin(pose[2]) / 0.5
        affine = np.array(
            [[sin, -cos, 100.0 - sin * pose[0] + cos * pose[1]], [cos, sin, 100.0 - cos * pose[0] - sin * pose[1]]]
        )
        slow = slow_reference(
            centers, size, around.boxes, around.present, around.ego_center, around.raster.cells, affine
        )
        return [float(each) for each in slow.final() - 0.02 + start]

    def around(self) -> ScoringSurroundings:
        """Everybody else, frame by frame, the ego last."""
        agents, ego = self.scene.agents, self.scene.ego
        others = [each for each in range(len(agents)) if each != self.agent]
        boxes, present, centers = [], [], []
        for frame in (self.frame + each for each in self.frames()):
            x, y, yaw = ego.pose[frame].tolist()
            ahead = float(self.scene.lidar.translation[0])
            own = [x + ahead * math.cos(yaw), y + ahead * math.sin(yaw), 7.0, 3.5, yaw]
            row = [
                [*agents.position[each, frame, :2], *agents.size[each, :2], agents.yaw[each, frame]] for each in others
            ]
            boxes.append([*row, own if self.reference else ego.boxes[frame].tolist()])
            present.append([*(bool(agents.valid[each, frame]) for each in others), True])
            centers.append([x, y] if self.reference else ego.boxes[frame, :2].tolist())
        pose = ego.pose[self.frame].copy()
        ahead = float(self.scene.lidar.translation[0])
        pose[:2] += [ahead * math.cos(pose[2]), ahead * math.sin(pose[2])]
        raster = DrivableRaster.around(self.scene.road_map, pose)
        return ScoringSurroundings(np.array(boxes), np.array(present), np.array(centers), raster)

    def drawn(self, scores: list[float]) -> list[int]:
        """With replacement, softmax(-score): walk along the shares until the uniform number is used up."""
        weight = [math.exp(-each) for each in scores]
        share = [each / sum(weight) for each in weight]
        chosen = []
        for left in self.rng.random(len(scores)):
            for index, each in enumerate(share):
                if left < each or index == len(share) - 1:
                    chosen.append(index)
                    break
                left -= each
        return chosen
