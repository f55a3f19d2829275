"""Overlays of a scene: plans with their verdicts, and candidates of the search."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

import cv2
import numpy as np

from benchmark.constants import PLAN_STEP_S
from benchmark.errors import InputError
from benchmark.geometry import Floats, box_corners
from benchmark.records.row_schema import SampleRow
from benchmark.records.scene_pages import RefinementTrace, ScenePage, TraceRound
from benchmark.report.palette import PlannerStyle
from benchmark.report.placement import (
    PlacedPlan,
    agent_box_at,
    ego_pose,
    find_plan_instant,
    frame_seconds,
    place_plan,
)

EXACT: Final = "exact"
PLANNING_S: Final = 1.0
"""The search plans anew so often."""
CANDIDATES_SHOWN: Final = 64
"""More lines than these are a blot; the best ones are drawn."""


@dataclass(frozen=True, slots=True)
class CollisionMark:
    """Place and time (since the sample) at which a plan, or a drive, first touches something.

    ``ego`` and ``other`` are (5,) footprints then, the latter ``None`` where the protocol does not say. ``point`` (2,)
    is in the middle of what they share.
    """

    seconds: float
    ego: Floats
    other: Floats | None
    point: Floats


class CollisionParty(Enum):
    """Party that a plan touches first."""

    ANYBODY = "anybody, in a scene without adversaries"
    ADVERSARY = "the adversary"
    OTHER = "another than the adversary"
    UNKNOWN = "the record does not say"


@dataclass(frozen=True, slots=True)
class PlanVerdict:
    """Verdict of one protocol on one sample, in words and in few words.

    ``collides`` is ``None`` where it cannot be said; ``counted`` is whether it enters the rates.
    """

    collides: bool | None
    words: str
    brief: str
    counted: bool
    whom: CollisionParty = CollisionParty.ANYBODY

    @property
    def alarms(self) -> bool:
        """Whether it shows the contact that is counted: with the adversary, where there is one."""
        return self.collides is True and self.whom in (CollisionParty.ANYBODY, CollisionParty.ADVERSARY)


@dataclass(frozen=True, slots=True)
class PlanOverlay:
    """One planner's last plan, ``None`` where it failed; ``details`` draws its other modes and forecasts."""

    name: str
    style: PlannerStyle
    plan: PlacedPlan | None
    contact: CollisionMark | None
    verdict: PlanVerdict
    age_s: float = 0.0
    details: bool = True

    @property
    def opacity(self) -> float:
        """A plan fades until the next one comes."""
        return 1.0 - 0.5 * min(self.age_s / PLAN_STEP_S, 1.0)


@dataclass(frozen=True, slots=True)
class CandidatesOverlay:
    """Candidates that the search chose from.

    ``paths`` (B, M, 2) are worst first, each from where the adversary was. ``shares`` (B,) are 0 for the best score, 1
    for the worst or infinite ones. ``chosen`` (M, 2) was executed; ``None`` where none was.
    """

    paths: Floats
    shares: Floats
    chosen: Floats | None


@dataclass(frozen=True, slots=True)
class PathOverlay:
    """Path of the recorded ego, beside one that was driven: (M, 2) centres of its body."""

    points: Floats


Overlay = PlanOverlay | CandidatesOverlay | PathOverlay


def describe_verdict(row: SampleRow, protocol: str, *, adversaries: bool = False) -> PlanVerdict:
    """Verdict of a protocol on a sample, in words; ``adversaries`` says whether the scene has any."""
    if row.status == "failed":
        return PlanVerdict(None, "the planner failed", "failed", counted=False)
    seconds = _find_collision_time(row, protocol)
    if row.outcomes[protocol].collision is None:
        return PlanVerdict(None, "its surroundings are not annotated", "no truth", counted=False)
    counted = row.outcomes[protocol].counted
    tail = "" if counted else ", not counted"
    if seconds is None and protocol == EXACT and row.outcomes[protocol].cut_short:
        known_s = PLAN_STEP_S * row.outcomes[protocol].l2.index(None)
        return PlanVerdict(False, f"no contact within {known_s:g} s, unknown beyond", "unknown", counted=False)
    if seconds is None:
        return PlanVerdict(False, f"no contact{tail}", "no contact", counted)
    cause = f" ({row.diagnosis.cause})" if protocol == EXACT and row.diagnosis is not None else ""
    exactly = row.outcomes[protocol].facts.get("first_contact_s") is not None
    when = f"{seconds:.1f} s ahead" if exactly else f"within {seconds:.1f} s"
    whom = _find_party(row.outcomes[protocol].touches_adversary) if adversaries else CollisionParty.ANYBODY
    verb, noun, rest = _WORDS[whom]
    return PlanVerdict(True, f"{verb} {when}{cause}{rest}{tail}", f"{noun} {seconds:.1f} s", counted, whom)


_WORDS: Final = {
    CollisionParty.ANYBODY: ("collides", "contact", ""),
    CollisionParty.ADVERSARY: ("hits the adversary", "contact", ""),
    CollisionParty.OTHER: ("hits another", "another", ""),
    CollisionParty.UNKNOWN: ("collides", "whom? in", ", whom is not said"),
}
"""Of each: what the plan does, in a word, and what follows."""


def _find_party(adversary: bool | None) -> CollisionParty:
    return (
        CollisionParty.UNKNOWN if adversary is None else CollisionParty.ADVERSARY if adversary else CollisionParty.OTHER
    )


def _find_collision_time(row: SampleRow, protocol: str) -> float | None:
    """Time at which a plan first touches something: to a tenth of a second under ``exact``, else the step's end."""
    if protocol not in row.outcomes:
        raise InputError(f"scene {row.scene} was not judged by protocol {protocol!r}; run challenger-bench rescore")
    outcome = row.outcomes[protocol]
    if outcome.collision is None or not any(outcome.collision):
        return None
    first = outcome.facts.get("first_contact_s")
    return float(first) if isinstance(first, int | float) else PLAN_STEP_S * (outcome.collision.index(True) + 1)


def build_plan_overlay(
    sheet: ScenePage, keyframe: int, row: SampleRow, protocol: str, name: str, style: PlannerStyle
) -> PlanOverlay:
    """A stored plan with its verdict, as it is at the sample, which is at frame ``keyframe``."""
    verdict = describe_verdict(row, protocol, adversaries=any(agent.adversary for agent in sheet.agents))
    plan = place_plan(row, ego_pose(sheet, keyframe))
    contact = None
    if plan is not None and verdict.collides:
        seconds = _find_collision_time(row, protocol)
        assert seconds is not None
        hit = row.outcomes[protocol].facts.get("hit")
        contact = _find_collision_mark(sheet, keyframe, plan, seconds, hit if isinstance(hit, str) else None)
    return PlanOverlay(name, style, plan, contact, verdict)


def build_candidates_overlay(sheet: ScenePage, trace: RefinementTrace, frame: int) -> CandidatesOverlay | None:
    """Candidates of the round of the executed one in the planning frame in force; ``None`` where none is in force."""
    seconds = frame_seconds(sheet)
    past = [trace_frame for trace_frame in trace.frames if trace_frame.frame <= frame]
    if not past or seconds[frame] - seconds[past[-1].frame] > PLANNING_S + 1e-6:
        return None
    current = past[-1]
    is_complete = 0 <= current.chosen_round < len(current.rounds) and _is_whole(
        current.rounds[current.chosen_round], current.chosen
    )
    if not is_complete:
        raise InputError(
            f"the trace of {trace.scene} lacks the candidate that it names as chosen at frame {current.frame}, or its "
            "lists differ in length; run challenger-bench sheets again"
        )
    chosen_round = current.rounds[current.chosen_round]
    paths = np.array(chosen_round.candidates, np.float64).reshape(len(chosen_round.candidates), -1, 2)
    return rank_candidates(paths, chosen_round.scores, current.chosen)


def rank_candidates(paths: Floats, scores: Sequence[float | None], chosen: int | None) -> CandidatesOverlay:
    """The best `CANDIDATES_SHOWN` of (B, M, 2) in drawing order; lower scores are better, ``None`` is infinite."""
    known = np.array([np.inf if score is None else score for score in scores])
    order = np.argsort(known, kind="stable")[:CANDIDATES_SHOWN][::-1]
    finite = known[np.isfinite(known)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    shares = np.clip((np.where(np.isfinite(known), known, high) - low) / max(high - low, 1e-9), 0.0, 1.0)
    shares[~np.isfinite(known)] = 1.0
    return CandidatesOverlay(paths[order], shares[order], None if chosen is None else paths[chosen])


def _is_whole(trace_round: TraceRound, chosen: int) -> bool:
    is_consistent = len({len(path) for path in trace_round.candidates}) == 1 and len(trace_round.scores) == len(
        trace_round.candidates
    )
    return is_consistent and 0 <= chosen < len(trace_round.candidates)


def _find_collision_mark(
    sheet: ScenePage, keyframe: int, plan: PlacedPlan, seconds: float, hit: str | None
) -> CollisionMark:
    ego = plan.footprints[find_plan_instant(seconds)]
    agent = next((candidate for candidate in sheet.agents if candidate.id == hit), None)
    at = float(frame_seconds(sheet)[keyframe]) + seconds
    other = None if agent is None else agent_box_at(sheet, agent, at)
    return CollisionMark(seconds, ego, other, ego[:2] if other is None else find_shared_point(ego, other))


def find_shared_point(first: Floats, second: Floats) -> Floats:
    """Middle of the overlap of two boxes (5,), or of their centres where rounding pulls them apart."""
    origin = first[:2]
    first_corners, second_corners = ((box_corners(box) - origin).astype(np.float32) for box in (first, second))
    area, polygon = cv2.intersectConvexConvex(first_corners, second_corners)
    if area <= 0.0 or polygon is None:
        return np.asarray((first[:2] + second[:2]) / 2)
    return np.asarray(polygon.reshape(-1, 2).mean(axis=0) + origin, np.float64)
