"""One unit of work: one vehicle of one scene becomes an adversary (Algorithm 1).

Pure: the same scene, vehicle, seed, settings and prior give the same track, whoever computes it and when.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely

from benchmark.dynamics.bicycle import MotionModel
from benchmark.errors import InputError
from benchmark.geometry import Floats, boxes_overlap
from benchmark.machine.storage import content_key, content_seed
from benchmark.records.scenes import TraceFrame
from benchmark.scene import Scene
from generation.build.ranking import challenge_score
from generation.labels.labelling import ClosestApproach, Labels, closest_approach, describe, times_to_collision
from generation.search.candidates import launch_frame
from generation.search.hyperparameters import HyperParameters
from generation.search.planning import Planning, PlanningFrame
from generation.search.proposals import Diversify, Prior, Search, Seconds, run_together
from generation.search.recorded_ego import log_replay_contacts
from generation.search.verify import Discard, Finding, verify

ALGORITHM_VERSION = "3"
"""Part of every content key; changes when the same inputs would give other tracks."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """What came of one (scene, vehicle, seed).

    Attributes:
        scene_name: Recorded scene.
        agent_id: Instance that was tried.
        seed: User's seed.
        finding: Why the result is not kept and what shows it, or ``None``.
        start: Frame of the launch, ``None`` if there was none.
        poses: (T - start, 3) executed poses of the box centre; fewer where planning gave up, (0, 3) without launch.
        challenge: Ranking score, see `ranking.challenge_score`; 0 where discarded.
        closest: Closest approach, where the track is complete.
        least_time_to_collision_s: Smallest of `labels.times_to_collision`, ``None`` if never within 5 s.
        plans: Trace.
        scene: The adversarial scene, if kept.
        tries: Searches that were made; everything else is about the last one.
        stage_seconds: Processor seconds of all tries by stage: sampling, physics, scoring, other (everything else).
            Not in the report.
        labels: What the adversary does, if kept.
        rounds: What was searched, where the whole track was planned and rounds are kept. Not in the report.
    """

    scene_name: str
    agent_id: str
    seed: int
    finding: Finding | None
    start: int | None
    poses: Floats
    challenge: float
    closest: ClosestApproach | None
    least_time_to_collision_s: float | None
    plans: tuple[PlanningFrame, ...]
    scene: Scene | None
    tries: int = 0
    stage_seconds: dict[str, float] = field(default_factory=dict)
    labels: Labels | None = None
    rounds: tuple[TraceFrame, ...] = ()

    @property
    def discard(self) -> Discard | None:
        """Why the result is not kept, or ``None``."""
        return None if self.finding is None else self.finding.reason

    @property
    def kept(self) -> bool:
        """Whether the scene survived verification."""
        return self.finding is None

    def report(self) -> dict[str, Any]:
        """Everything but the track and the scene, as JSON values."""
        closest = self.closest
        return {
            "scene": self.scene_name,
            "agent": self.agent_id,
            "seed": self.seed,
            "kept": self.kept,
            "discard": None if self.discard is None else self.discard.value,
            "because": None if self.finding is None else self.finding.as_json(),
            "launch_frame": self.start,
            "tries": self.tries,
            "challenge": self.challenge,
            "closest_approach": None
            if closest is None
            else {"gap_m": closest.gap_m, "time_s": closest.time_s, "side": closest.side.value},
            "least_time_to_collision_s": self.least_time_to_collision_s,
            "labels": None if self.labels is None else self.labels.as_json(),
            "plans": [
                {
                    "frame": plan.frame,
                    "round": plan.chosen_round,
                    "score": plan.score,
                    "best_scores": list(plan.best_scores),
                    "collision_free": list(plan.collision_free),
                }
                for plan in self.plans
            ],
        }


def attempt(
    scene: Scene,
    agent_index: int,
    seed: int,
    hyper: HyperParameters,
    prior: Prior,
    *,
    diversify: Diversify | None = None,
    model: MotionModel | None = None,
    keep_rounds: bool = False,
) -> Attempt:
    """Let one vehicle challenge the ego from its launch to the end of the scene, with ``hyper.tries`` chances.

    Args:
        scene: The recorded scene; earlier adversaries in it are surroundings like any other vehicle.
        agent_index: Index of the vehicle.
        seed: User's seed; part of a seed made of content.
        hyper: Settings.
        prior: Diffusion model.
        diversify: Spread of the initial batch; the package's own by default.
        model: Physics; `MotionModel.si` by default.
        keep_rounds: Whether the candidates of every round are kept; no other result depends on it.

    Returns:
        The kept scene, or the reason why there is none.

    Raises:
        InputError: If there is no such vehicle or the model has no limits.
    """
    vehicles = [(scene, agent_index)]
    return attempts_together(vehicles, seed, hyper, prior, diversify=diversify, model=model, keep_rounds=keep_rounds)[0]


def attempts_together(
    vehicles: Sequence[tuple[Scene, int]],
    seed: int,
    hyper: HyperParameters,
    prior: Prior,
    *,
    diversify: Diversify | None = None,
    model: MotionModel | None = None,
    keep_rounds: bool = False,
) -> list[Attempt]:
    """Attempts side by side, so that the diffusion model answers all of them in one call; each is as if alone.

    Args:
        vehicles: Scenes and indices of vehicles in them.
        seed: As in `attempt`.
        hyper: As in `attempt`.
        prior: As in `attempt`.
        diversify: As in `attempt`.
        model: As in `attempt`.
        keep_rounds: As in `attempt`.

    Returns:
        One attempt for each vehicle.

    Raises:
        InputError: If there is no such vehicle or the model has no limits.
    """
    model = model or MotionModel.si()
    if model.limits is None:
        raise InputError("executing a plan needs a motion model with limits, use MotionModel.si()")
    for scene, agent in vehicles:
        if not 0 <= agent < len(scene.agents):
            raise InputError(f"{scene.name} has {len(scene.agents)} agents, there is no agent {agent}")
    diversify = diversify or _packaged_diversify()
    searches = [
        _chances(scene, agent, seed, hyper, prior.fingerprint, diversify, model, keep_rounds)
        for scene, agent in vehicles
    ]
    found, spent = run_together(searches, prior)
    return [
        replace(result, stage_seconds=_stage_seconds(result.stage_seconds, seconds))
        for result, seconds in zip(found, spent, strict=True)
    ]


def _stage_seconds(simulated_and_scored: Mapping[str, float], spent: Seconds) -> dict[str, float]:
    """All of an attempt's seconds by stage; what a search does beside physics and scoring is ``other``."""
    other = spent.search - sum(simulated_and_scored.values())
    return {"sampling": spent.answers, "physics": 0.0, "scoring": 0.0, **simulated_and_scored, "other": other}


def _chances(
    scene: Scene,
    agent: int,
    seed: int,
    hyper: HyperParameters,
    prior_fingerprint: str,
    diversify: Diversify,
    model: MotionModel,
    keep_rounds: bool,
) -> Search[Attempt]:
    """Searches for one vehicle until one is kept or there is no use in another."""
    blank = Attempt(scene.name, scene.agents.ids[agent], seed, None, None, np.zeros((0, 3)), 0.0, None, None, (), None)
    start = launch_frame(scene, agent, hyper)
    if start is None:
        return replace(blank, finding=Finding(Discard.NEVER_LAUNCHED))
    if ego_already_collides(scene):
        return replace(blank, start=start, finding=Finding(Discard.ORIGINAL_COLLIDES))
    content = (scene_identity(scene), blank.agent_id, seed, hyper.fingerprint, prior_fingerprint, ALGORITHM_VERSION)
    stages = {"physics": 0.0, "scoring": 0.0}
    result = blank
    for number in range(hyper.tries):
        rng = np.random.default_rng(content_seed(*content, number))
        planning = Planning(scene, agent, start, hyper, diversify, model, rng, stages, keep_rounds)
        driven = yield from planning.run()
        tried = replace(blank, start=start, tries=number + 1, poses=driven.poses, plans=driven.plans)
        if driven.gave_up is None:
            result = replace(_judged(tried, planning), rounds=driven.rounds)
        else:
            result = replace(tried, finding=driven.gave_up)
        # A vehicle that the area loses drives the other way; it would be lost again.
        if result.kept or result.discard is Discard.LEAVES_AREA:
            break
    return replace(result, stage_seconds=stages)


def _judged(driven: Attempt, planning: Planning) -> Attempt:
    """The attempt with its verdict and its numbers."""
    agent, start, limits = planning.agent, planning.start, planning.model.limits
    assert limits is not None
    changed = planning.scene.with_adversary(agent, slice(start, start + len(driven.poses)), driven.poses)
    finding = verify(changed, agent, start, planning.hyper, limits)
    soonest = float(times_to_collision(changed, agent, start).min())
    return replace(
        driven,
        finding=finding,
        challenge=challenge_score(changed, agent, start) if finding is None else 0.0,
        closest=closest_approach(changed, agent, start),
        least_time_to_collision_s=None if np.isinf(soonest) else soonest,
        scene=changed if finding is None else None,
        labels=describe(changed, agent, start) if finding is None else None,
    )


def ego_already_collides(scene: Scene) -> bool:
    """Whether the recorded ego touches anything before an adversary is added."""
    at_frames = scene.agents.valid & boxes_overlap(scene.agents.boxes, scene.ego.boxes[None])
    return bool(at_frames.any()) or bool(log_replay_contacts(scene).any())


def scene_identity(scene: Scene) -> str:
    """Content key of all that generation reads of a scene: motion, sizes, categories, drivable area."""
    digest = hashlib.sha256()
    agents, notes = scene.agents, scene.annotations
    for array in (
        scene.timestamps_us, scene.keyframes, scene.ego.position, scene.ego.rotation, agents.position, agents.yaw,
        agents.size, agents.valid, notes.position, notes.rotation, notes.size, notes.valid, scene.lidar.translation,
    ):  # fmt: skip
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(shapely.to_wkb(scene.road_map.drivable_area))
    return content_key(scene.name, agents.ids, agents.categories, scene.adversaries, digest.hexdigest())


def _packaged_diversify() -> Diversify:
    # Imported late: it brings torch, which nothing else in this module needs.
    from generation.diffusion.prior import diversify

    return diversify
