"""A stand-in for the diffusion model: smooth random driving around constant velocity."""

from collections.abc import Sequence

import numpy as np

from benchmark.geometry import Floats
from generation.search.proposals import Request, SamplingRequest


class DrivingPrior:
    fingerprint = "random smooth driving"

    def answer(self, requests: Sequence[Request]) -> list[Floats]:
        return [
            self.sample(asked.count, asked.previous, asked.rng)
            if isinstance(asked, SamplingRequest)
            else self.mutate(asked.waypoints, asked.noise_level, asked.previous, asked.rng)
            for asked in requests
        ]

    def sample(self, count: int, previous: Floats, rng: np.random.Generator) -> Floats:
        speed = np.hypot(previous[0], previous[1]) / 0.5
        acceleration = rng.normal(0.0, 1.5, (count, 1)) + np.cumsum(rng.normal(0.0, 0.5, (count, 16)), axis=1)
        speeds = np.maximum(speed + np.cumsum(0.5 * acceleration, axis=1), 0.0)
        curvature = rng.normal(0.0, 0.04, (count, 1)) + np.cumsum(rng.normal(0.0, 0.01, (count, 16)), axis=1)
        heading = np.cumsum(0.5 * speeds * curvature, axis=1)
        x = np.cumsum(0.5 * speeds * np.cos(heading), axis=1)
        y = np.cumsum(0.5 * speeds * np.sin(heading), axis=1)
        return np.stack([x, y, heading], axis=-1)

    def mutate(self, waypoints: Floats, noise_level: int, previous: Floats, rng: np.random.Generator) -> Floats:
        bend = np.cumsum(np.cumsum(rng.normal(0.0, 0.02 * noise_level, (len(waypoints), 16, 2)), axis=1), axis=1)
        return np.concatenate([waypoints[..., :2] + 0.2 * bend, waypoints[..., 2:]], axis=-1)


def unchanged(waypoints: Floats, rng: np.random.Generator) -> Floats:
    return waypoints
