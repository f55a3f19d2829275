"""One unit of work: one vehicle of one scene becomes an adversary (Algorithm 1), with the same track on any machine."""

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely

from benchmark.dynamics.bicycle import MotionModel
from benchmark.errors import InputError
from benchmark.fairness.scene_assessment import AdversaryProvenance, assess_scene
from benchmark.geometry import Floats, boxes_overlap
from benchmark.machine.extension import import_from_extension
from benchmark.machine.storage import content_key, content_seed
from benchmark.records.attempts import Approach, Attempt
from benchmark.records.scene_pages import TraceFrame
from benchmark.scene import Scene
from generation.labels.labelling import compute_labels, compute_times_to_collision, find_closest_approach
from generation.labels.manoeuvres import Manoeuvre
from generation.search.candidates import find_launch_frame
from generation.search.driven_tracks import DrivenTracks
from generation.search.hyperparameters import DiscardRules, HyperParameters
from generation.search.planning import AdversaryPlanning
from generation.search.proposals import Diversify, Prior, SearchSeconds, SearchSteps, run_searches
from generation.search.ranking import compute_challenge_score
from generation.search.recorded_motion import find_log_replay_contacts
from generation.search.threat_settings import CandidateProposal, EgoDriver
from generation.search.verify import DiscardReason, VerificationFailure, check_fairness, count_masked_steps, verify

ALGORITHM_VERSION = "4"
"""Part of every content key; changes when the same inputs would give other tracks."""


@dataclass(frozen=True, slots=True)
class SearchOutcome:
    """Outcome of the search with one (scene, vehicle, seed).

    ``poses`` are (T - start, 3), executed, of the box centre; fewer where planning gave up, (0, 3) without launch.
    ``driven`` are tracks of an ego that reacted.
    ``stage_seconds`` are processor seconds of all tries: sampling, physics, scoring, other (everything else).
    """

    attempt: Attempt
    finding: VerificationFailure | None
    poses: Floats
    scene: Scene | None = None
    rounds: tuple[TraceFrame, ...] = ()
    stage_seconds: dict[str, float] = field(default_factory=dict)
    driven: DrivenTracks | None = None

    @property
    def kept(self) -> bool:
        """Whether the scene survived verification."""
        return self.finding is None

    def discarded(self, finding: VerificationFailure) -> "SearchOutcome":
        """The same without a scene, for a reason."""
        changes = {"kept": False, "discard": finding.reason.value, "because": finding.as_json(), "challenge": 0.0}
        return replace(self, attempt=self.attempt.model_copy(update=changes), finding=finding, scene=None)


def search_vehicles(
    vehicles: Sequence[tuple[Scene, int]],
    seed: int,
    hyper: HyperParameters,
    prior: Prior,
    *,
    diversify: Diversify | None = None,
    model: MotionModel | None = None,
    keep_rounds: bool = False,
    earlier: Sequence[Mapping[str, int]] | None = None,
    asked: Sequence[Manoeuvre | None] | None = None,
) -> list[SearchOutcome]:
    """Let vehicles challenge the ego from their launch to the end of the scene, with ``hyper.tries`` chances each.

    They are searched side by side, so that the diffusion model answers all of them in one call; each is as if alone.
    Earlier adversaries are surroundings like any other; ``earlier`` has their launch frames by identifier, for each
    vehicle. ``asked`` is the manoeuvre requested from each, ``None`` for any. No other result depends on
    ``keep_rounds``.
    """
    model = model or hyper.motion_model()
    for scene, agent in vehicles:
        if not 0 <= agent < len(scene.agents):
            raise InputError(f"{scene.name} has {len(scene.agents)} agents, so there is no agent {agent}")
    diversify = diversify or (_load_packaged_diversify() if hyper.varied else _keep_unchanged)
    searches = [
        _search_vehicle(scene, agent, seed, hyper, prior.fingerprint, diversify, model, keep_rounds, launches, kind)
        for (scene, agent), launches, kind in zip(
            vehicles, earlier or [{}] * len(vehicles), asked or [None] * len(vehicles), strict=True
        )
    ]
    outcomes, spent = run_searches(searches, prior)
    return [
        replace(result, stage_seconds=_compute_stage_seconds(result.stage_seconds, seconds))
        for result, seconds in zip(outcomes, spent, strict=True)
    ]


def _compute_stage_seconds(simulated_and_scored: Mapping[str, float], spent: SearchSeconds) -> dict[str, float]:
    """Seconds of an attempt by stage; what a search does beside physics and scoring is ``other``."""
    other = spent.search - sum(simulated_and_scored.values())
    return {"sampling": spent.answers, "physics": 0.0, "scoring": 0.0, **simulated_and_scored, "other": other}


def _search_vehicle(
    scene: Scene,
    agent: int,
    seed: int,
    hyper: HyperParameters,
    prior_fingerprint: str,
    diversify: Diversify,
    model: MotionModel,
    keep_rounds: bool,
    earlier: Mapping[str, int],
    asked: Manoeuvre | None,
) -> SearchSteps[SearchOutcome]:
    """Search until a result is kept or there is no use in another try."""
    sampled, reacts = hyper.proposal is CandidateProposal.SAMPLED, hyper.ego is not EgoDriver.RECORDED
    alone = drive_ego(scene, hyper.ego)
    start = find_launch_frame(alone, agent, hyper) if sampled else 0
    blank = _build_blank_outcome(scene.name, scene.agents.ids[agent], seed, start, asked)
    if start is None:
        return blank.discarded(VerificationFailure(DiscardReason.NEVER_LAUNCHED))
    if hyper.discards is not DiscardRules.REFERENCE and does_ego_already_collide(alone):
        return blank.discarded(VerificationFailure(DiscardReason.ORIGINAL_COLLIDES))
    if not sampled:
        return _judge_proposed(blank, scene, agent, hyper, diversify, model, earlier)
    content = (compute_scene_identity(scene), blank.attempt.agent, seed, hyper.fingerprint, prior_fingerprint)
    request = () if asked is None else (asked.value,)
    stages = {"physics": 0.0, "scoring": 0.0}
    kind = import_from_extension("search", "pressing") if reacts else AdversaryPlanning
    result, most = blank, -1.0
    for number in range(hyper.tries):
        rng = np.random.default_rng(content_seed(*content, ALGORITHM_VERSION, number, *request))
        planning = kind(scene, agent, start, hyper, diversify, model, rng, stages, keep_rounds, asked)
        driven = yield from planning.run()
        attempt = blank.attempt.model_copy(update={"tries": number + 1, "plans": driven.plans})
        outcome = SearchOutcome(attempt, None, driven.poses, rounds=driven.rounds, driven=driven.driven)
        tried = _assess(outcome, planning, earlier) if driven.failure is None else outcome.discarded(driven.failure)
        pressure = driven.pressure if tried.kept else -1.0
        if number == 0 or pressure > most or not result.kept:
            result, most = tried, pressure
        # A vehicle that left the area drives away from it, and would leave it again.
        left = tried.finding is not None and tried.finding.reason is DiscardReason.LEAVES_AREA
        if not reacts and (tried.kept or left):
            break
    return replace(result, stage_seconds=stages)


def drive_ego(scene: Scene, ego: EgoDriver) -> Scene:
    """A scene with its ego as that drives where nobody challenges it: as recorded, or a reference driver."""
    driven: Scene = scene if ego is EgoDriver.RECORDED else import_from_extension("search", "ego")(scene, ego)
    return driven


def _judge_proposed(
    blank: SearchOutcome,
    scene: Scene,
    agent: int,
    hyper: HyperParameters,
    diversify: Diversify,
    model: MotionModel,
    earlier: Mapping[str, int],
) -> SearchOutcome:
    """First kept of at most ``hyper.tries`` tracks that an extension proposes; none is drawn by chance."""
    result = blank.discarded(VerificationFailure(DiscardReason.NO_SAFE_CANDIDATE))
    proposals = import_from_extension("search", "retiming")(scene, agent, hyper)
    for number, (start, poses) in enumerate(itertools.islice(proposals, hyper.tries)):
        planning = AdversaryPlanning(scene, agent, start, hyper, diversify, model, np.random.default_rng(0), {})
        attempt = blank.attempt.model_copy(update={"tries": number + 1, "launch_frame": start})
        result = _assess(SearchOutcome(attempt, None, poses), planning, earlier)
        if result.kept:
            break
    return result


def _build_blank_outcome(
    scene_name: str, agent_id: str, seed: int, start: int | None, asked: Manoeuvre | None
) -> SearchOutcome:
    attempt = Attempt(
        scene=scene_name,
        agent=agent_id,
        seed=seed,
        kept=True,
        discard=None,
        because=None,
        launch_frame=start,
        tries=0,
        challenge=0.0,
        closest_approach=None,
        least_time_to_collision_s=None,
        labels=None,
        plans=(),
    )
    if asked is not None:
        # Without a requested manoeuvre the report is unchanged from earlier versions.
        attempt = attempt.model_copy(update={"asked": asked.value})
    return SearchOutcome(attempt, None, np.zeros((0, 3)))


def _assess(outcome: SearchOutcome, planning: AdversaryPlanning, earlier: Mapping[str, int]) -> SearchOutcome:
    agent, start = planning.agent, planning.start
    changed = planning.scene if outcome.driven is None else outcome.driven.put_into(planning.scene)
    changed = changed.with_adversary(agent, slice(start, start + len(outcome.poses)), outcome.poses)
    # The reference code makes all its checks at the planning frames.
    verified_here = planning.hyper.discards is not DiscardRules.REFERENCE
    finding = verify(changed, agent, start, planning.hyper, planning.model.limits) if verified_here else None
    if finding is None and planning.hyper.behaviour:
        finding = import_from_extension("search", "behaviour")(changed, agent, start)
    soonest = float(compute_times_to_collision(changed, agent, start).min())
    closest = find_closest_approach(changed, agent, start)
    changes: dict[str, Any] = {
        "closest_approach": Approach(gap_m=closest.gap_m, time_s=closest.time_s, side=closest.side),
        "least_time_to_collision_s": None if np.isinf(soonest) else soonest,
    }
    if finding is None:
        labels = compute_labels(changed, agent, start)
        changes |= {
            "challenge": compute_challenge_score(changed, agent, start),
            "labels": labels,
            "masked_steps": count_masked_steps(changed),
        }
        if planning.asked is not None and labels.manoeuvre != planning.asked.value:
            finding = VerificationFailure(DiscardReason.ANOTHER_MANOEUVRE, quantity=labels.manoeuvre)
    if finding is None:
        launches = {**earlier, outcome.attempt.agent: start}
        changes["judgements"] = assess_scene(changed, AdversaryProvenance(generated=True, launches=launches))
        finding = check_fairness(changed, changes["judgements"], planning.hyper)
    result = replace(outcome, attempt=outcome.attempt.model_copy(update=changes), scene=changed)
    return result if finding is None else result.discarded(finding)


def does_ego_already_collide(scene: Scene) -> bool:
    """Whether the recorded ego touches anything before an adversary is added."""
    at_frames = scene.agents.valid & boxes_overlap(scene.agents.boxes, scene.ego.boxes[None])
    return bool(at_frames.any()) or bool(find_log_replay_contacts(scene).any())


def compute_scene_identity(scene: Scene) -> str:
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


def _keep_unchanged(waypoints: Floats, rng: np.random.Generator) -> Floats:
    return waypoints


def _load_packaged_diversify() -> Diversify:
    # Imported late: it brings torch, which nothing else in this module needs.
    from generation.diffusion.prior import diversify

    return diversify
