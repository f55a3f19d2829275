"""Which of the surviving scenes are rendered: the most challenging ones."""

from collections import Counter
from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np

from benchmark.scene import Scene
from generation.labels.labelling import compute_body_gaps, compute_ego_speed, compute_times_to_collision

CLOSE_M = 10.0
"""Gap at which closeness begins to count."""
THREAT_S = 3.0
"""Horizon of a plan: a plan is not responsible for later conflicts."""
MOVING_M_S = 3.0
"""Speed of the ego from which on a frame counts in full."""


class RankedScene(Protocol):
    """Contents of a generated scene that ranking reads: its recording, its adversary and its challenge score."""

    @property
    def scene_name(self) -> str:
        """Name of the recorded scene."""

    @property
    def agent_id(self) -> str:
        """Instance identifier of the adversary."""

    @property
    def challenge(self) -> float:
        """Higher is more challenging."""


AnyRankedScene = TypeVar("AnyRankedScene", bound=RankedScene)


def compute_challenge_score(scene: Scene, agent: int, start: int) -> float:
    """Closeness with which an adversary presses a moving ego over the scene, 0 to 1, higher is more challenging.

    The paper ranks by "adversarial challenge score" without saying how frames are combined. Here: the mean, over the
    frames from the launch on, of the average of

    * closeness, 1 - gap / 10 m (not negative) between the bodies, and
    * threat, 1 if the two would meet within 3 s at their present velocities, because a car that follows closely at
      the ego's own speed is close all the time and asks nothing of the ego,

    weighted by the ego's speed up to 3 m/s, because nothing near a standing ego is a challenge to it.
    """
    closeness = np.clip(1.0 - compute_body_gaps(scene, agent, start) / CLOSE_M, 0.0, 1.0)
    threat = compute_times_to_collision(scene, agent, start) <= THREAT_S
    moving = np.clip(compute_ego_speed(scene)[start:] / MOVING_M_S, 0.0, 1.0)
    return float(np.mean(0.5 * (closeness + threat) * moving))


def rank_scenes(results: Sequence[AnyRankedScene], *, per_scene: int | None, total: int | None) -> list[AnyRankedScene]:
    """The most challenging scenes, best first, ties by name; at most ``per_scene`` of one recording."""
    order = sorted(results, key=lambda result: (-result.challenge, result.scene_name, result.agent_id))
    taken: Counter[str] = Counter()
    selected: list[AnyRankedScene] = []
    for result in order:
        if total is not None and len(selected) >= total:
            break
        if per_scene is None or taken[result.scene_name] < per_scene:
            taken[result.scene_name] += 1
            selected.append(result)
    return selected
