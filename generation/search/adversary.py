"""One unit of work: one vehicle of one scene becomes an adversary (Algorithm 1).

Pure: the same scene, vehicle, seed, settings and prior give the same track, whoever computes it and when.
"""

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely

from benchmark.constants import FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import MotionModel, VehicleState, rear_axle, simulate
from benchmark.errors import InputError
from benchmark.geometry import Floats, boxes_overlap, to_local, wrap_angle
from benchmark.machine.storage import content_key, content_seed
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.build.ranking import challenge_score
from generation.labels.labelling import ClosestApproach, Labels, closest_approach, describe, times_to_collision
from generation.search.candidates import in_canvas, initial_state, launch_frame
from generation.search.hyperparameters import HyperParameters
from generation.search.proposals import Diversify, Prior, Search, Seconds, run_together
from generation.search.recorded_ego import log_replay_contacts
from generation.search.refinement import Batch, Evaluated, NothingToDraw, Refinement, refine
from generation.search.scoring import score_terms, surroundings
from generation.search.verify import EGO, Discard, Finding, contacts, verify

ALGORITHM_VERSION = "3"
"""Part of every content key; changes when the same inputs would give other tracks."""


@dataclass(frozen=True, slots=True)
class PlanningFrame:
    """Trace of one planning frame.

    Attributes:
        frame: Frame index.
        chosen_round: Round of the executed candidate.
        score: Its final score over all rounds, ``None`` if no candidate was finite.
        best_scores: Best final score of each round, normalised within the round.
        collision_free: Candidates without contact in each round.
    """

    frame: int
    chosen_round: int
    score: float | None
    best_scores: tuple[float | None, ...]
    collision_free: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Planned:
    """Everything that was searched at one planning frame.

    Attributes:
        agent_id: Instance of the vehicle.
        search: Number of the search for this vehicle, 0 first.
        frame: Frame index.
        state: Motion of the vehicle there.
        batches: The rounds.
        found: What came of them.
    """

    agent_id: str
    search: int
    frame: int
    state: VehicleState
    batches: Sequence[Batch]
    found: Refinement


Watch = Callable[[Planned], None]


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
    watch: Watch | None = None,
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
        watch: Is shown every planning frame; no result depends on it.

    Returns:
        The kept scene, or the reason why there is none.

    Raises:
        InputError: If there is no such vehicle or the model has no limits.
    """
    vehicles = [(scene, agent_index)]
    return attempts_together(vehicles, seed, hyper, prior, diversify=diversify, model=model, watch=watch)[0]


def attempts_together(
    vehicles: Sequence[tuple[Scene, int]],
    seed: int,
    hyper: HyperParameters,
    prior: Prior,
    *,
    diversify: Diversify | None = None,
    model: MotionModel | None = None,
    watch: Watch | None = None,
) -> list[Attempt]:
    """Attempts side by side, so that the diffusion model answers all of them in one call; each is as if alone.

    Args:
        vehicles: Scenes and indices of vehicles in them.
        seed: As in `attempt`.
        hyper: As in `attempt`.
        prior: As in `attempt`.
        diversify: As in `attempt`.
        model: As in `attempt`.
        watch: As in `attempt`; the planning frames of different vehicles come mixed.

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
        _chances(scene, agent, seed, hyper, prior.fingerprint, diversify, model, watch) for scene, agent in vehicles
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
    watch: Watch | None,
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
        hunt = _Hunt(scene, agent, start, hyper, diversify, model, rng, stages, number, watch)
        poses, plans, gave_up = yield from hunt.run()
        driven = replace(blank, start=start, tries=number + 1, poses=poses, plans=plans, finding=gave_up)
        result = _judged(driven, hunt) if gave_up is None else driven
        # A vehicle that the area loses drives the other way; it would be lost again.
        if result.kept or result.discard is Discard.LEAVES_AREA:
            break
    return replace(result, stage_seconds=stages)


def _judged(driven: Attempt, hunt: "_Hunt") -> Attempt:
    """The attempt with its verdict and its numbers."""
    agent, start, limits = hunt.agent, hunt.start, hunt.model.limits
    assert limits is not None
    changed = hunt.scene.with_adversary(agent, slice(start, start + len(driven.poses)), driven.poses)
    finding = verify(changed, agent, start, hunt.hyper, limits)
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


@dataclass(frozen=True, slots=True)
class _Hunt:
    """Planning frames of one adversary, one after the other; ``stages`` adds up seconds of physics and scoring."""

    scene: Scene
    agent: int
    start: int
    hyper: HyperParameters
    diversify: Diversify
    model: MotionModel
    rng: np.random.Generator
    stages: dict[str, float]
    number: int = 0
    watch: Watch | None = None

    def run(self) -> Search[tuple[Floats, tuple[PlanningFrame, ...], Finding | None]]:
        """Executed poses (F, 3), trace, and why the rest was not planned: what `verify` could only discard."""
        assert self.model.limits is not None
        state = initial_state(self.scene, self.agent, self.start, self.model.limits)
        track = [self._recorded_pose(self.start)[None]]
        plans: list[PlanningFrame] = []
        for frame in range(self.start, len(self.scene.timestamps_us) - 1, self.hyper.horizon):
            try:
                found = yield from self._plan(frame, state, np.concatenate(track))
            except NothingToDraw:
                return np.concatenate(track), tuple(plans), Finding(Discard.NOTHING_TO_DRAW, frame)
            steps = min(self.hyper.horizon, len(self.scene.timestamps_us) - 1 - frame)
            executed = found.motion.center[found.chosen, 1 : steps + 1]
            plans.append(_trace(frame, found))
            finding = self._fault(frame, executed)
            if finding is not None and finding.reason is not Discard.LEAVES_AREA:
                return np.concatenate(track), tuple(plans), finding
            track.append(executed)
            if finding is not None:
                return np.concatenate(track), tuple(plans), finding
            state = found.motion.state(found.chosen, steps)
        return np.concatenate(track), tuple(plans), None

    def _fault(self, frame: int, executed: Floats) -> Finding | None:
        """Why there is no use in going on after executing (F, 3) poses from the frame after ``frame`` on."""
        if not np.isfinite(executed).all():
            return Finding(Discard.NO_SAFE_CANDIDATE, frame)
        touched = self._touched(frame, executed) if self.hyper.scored else None
        if touched is not None:
            return Finding(Discard.NO_SAFE_CANDIDATE, frame, touched)
        inside = in_canvas(self.scene, executed[:, :2], self.hyper.half_extent_m, first=frame + 1)
        return None if inside.all() else Finding(Discard.LEAVES_AREA, frame + 1 + int(np.argmin(inside)))

    def _plan(self, frame: int, state: VehicleState, track: Floats) -> Search[Refinement]:
        offsets = tuple(offset for offset in self.hyper.scored_frames if frame + offset < len(self.scene.timestamps_us))
        raster = _raster(self.scene, frame, self.hyper.half_extent_m)
        around = surroundings(self.scene, self.agent, tuple(frame + offset for offset in offsets), raster)
        size = self.scene.agents.size[self.agent, :2]
        previous = self._previous(frame, state, track)

        def evaluate(waypoints: Floats) -> Evaluated:
            begun = time.process_time()
            motion = simulate(waypoints, state, float(size[0]), steps=offsets[-1], model=self.model)
            simulated = time.process_time()
            terms = score_terms(motion.center[:, offsets], size, around, self.hyper, speed=motion.states[:, offsets, 3])
            self.stages["physics"] += simulated - begun
            self.stages["scoring"] += time.process_time() - simulated
            return Evaluated(motion, terms)

        def shown(batches: Sequence[Batch], found: Refinement) -> None:
            if self.watch is not None:
                agent_id = self.scene.agents.ids[self.agent]
                self.watch(Planned(agent_id, self.number, frame, state, batches, found))

        return (yield from refine(self.diversify, evaluate, previous, self.hyper, self.rng, watch=shown))

    def _previous(self, frame: int, state: VehicleState, track: Floats) -> Floats:
        """Own rear-axle pose (3,) half a second ago in the local frame: recorded before the launch, executed after."""
        past = frame - FRAMES_PER_KEYFRAME
        center = track[past - self.start] if past >= self.start else self._recorded_pose(max(past, 0))
        axle = rear_axle(center, float(self.scene.agents.size[self.agent, 0]))
        turn = wrap_angle(axle[2:] - state.pose[2])
        return np.concatenate([to_local(axle[:2], state.pose), turn])

    def _recorded_pose(self, frame: int) -> Floats:
        agents = self.scene.agents
        return np.array([*agents.position[self.agent, frame, :2], agents.yaw[self.agent, frame]])

    def _touched(self, frame: int, executed: Floats) -> str | None:
        """Who is touched first, or ``None``."""
        frames = frame + 1 + np.arange(len(executed))
        size = np.broadcast_to(self.scene.agents.size[self.agent, :2], (len(executed), 2))
        boxes = np.column_stack([executed[:, :2], size, executed[:, 2]])
        if boxes_overlap(boxes, self.scene.ego.boxes[frames]).any():
            return EGO
        _, other = contacts(boxes, self.scene, self.agent, frames)
        return self.scene.agents.ids[other[0]] if len(other) else None


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


def _raster(scene: Scene, frame: int, half_extent_m: float) -> DrivableRaster:
    """Drivable area around the ego's lidar at a planning frame."""
    pose = scene.ego.pose[frame]
    pose[:2] += scene.lidar.translation[0] * np.array([np.cos(pose[2]), np.sin(pose[2])])
    return DrivableRaster.around(scene.road_map, pose, half_extent_m=half_extent_m)


def _packaged_diversify() -> Diversify:
    # Imported late: it brings torch, which nothing else in this module needs.
    from generation.diffusion.prior import diversify

    return diversify


def _trace(frame: int, found: Refinement) -> PlanningFrame:
    def finite(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return PlanningFrame(
        frame,
        found.round,
        finite(found.score),
        tuple(finite(float(entry.scores.min())) for entry in found.rounds),
        tuple(entry.collision_free for entry in found.rounds),
    )
