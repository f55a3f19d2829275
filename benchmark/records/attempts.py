"""Stored attempts of the search for adversaries: ``attempts.jsonl`` and reports in ``challenger.json``.

Splits that differ in the seed of the search alone: their names, and what made them.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field

from benchmark.machine.storage import read_json_lines
from benchmark.records.run_schema import GeneratedFacts
from benchmark.records.scene_assessment import SceneAssessment
from benchmark.records.store import validate_stored

ATTEMPTS_FILE: Final = "attempts.jsonl"


class _AttemptModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    def as_json(self) -> dict[str, Any]:
        """The fields that are known, as JSON values; what an older version did not write stays away."""
        return self.model_dump(mode="json", exclude_unset=True)


class Approach(_AttemptModel):
    """Closest approach of two bodies, when (seconds since the scene's first frame), and on which side of the ego.

    Attributes:
        side: Side of the ego (`generation.labels.labelling.Side`).
    """

    gap_m: float
    time_s: float
    side: str


class ClosestApproach(Approach):
    """The moment at which two bodies are closest; ``frame`` is its index."""

    frame: int


class ManoeuvreOccurrence(_AttemptModel):
    """One kind of manoeuvre in a scene.

    Attributes:
        kind: Which (`generation.labels.manoeuvres.Manoeuvre`).
        first_s: When it began the first time, seconds since the scene's first frame.
        duration_s: How long it lasted, all times together.
        least_gap_m: Smallest gap between the bodies meanwhile.
    """

    kind: str
    first_s: float
    duration_s: float
    least_gap_m: float


class Encroachment(_AttemptModel):
    """Closest succession of the two bodies on one and the same piece of the ego's path (post-encroachment time).

    Attributes:
        seconds: Time between them; 0 if both were there at once, as abreast in a bend.
        time_s: When the other vehicle was there, seconds since the scene's first frame.
    """

    seconds: float
    ego_first: bool
    time_s: float


class TimeToCollision(_AttemptModel):
    """The smallest time to collision of a scene, and when it was that small first, seconds since the first frame."""

    seconds: float
    time_s: float


class ManoeuvreLabels(_AttemptModel):
    """Manoeuvres of one adversary towards the ego, and their place; ``docs/manoeuvres.md`` defines every word.

    Attributes:
        occurred: Every kind that occurred, the primary one first.
        time_to_collision: ``None`` if it was never within 5 s.
        encroachment: Closest succession on the same piece of the ego's path, ``None`` if there was none.
        place: Where the closest approach happened (`benchmark.metrics.places.PlaceKind`).
    """

    manoeuvre: str
    occurred: tuple[ManoeuvreOccurrence, ...]
    closest_approach: ClosestApproach
    time_to_collision: TimeToCollision | None
    encroachment: Encroachment | None
    place: str


class PlanningFrame(_AttemptModel):
    """Trace of one planning frame of the search.

    Attributes:
        round: Round of the executed candidate.
        score: Its final score over all rounds, ``None`` if no candidate was finite.
        best_scores: Best final score of each round, normalised within the round.
        collision_free: Candidates without contact in each round.
    """

    frame: int
    round: int
    score: float | None
    best_scores: tuple[float | None, ...]
    collision_free: tuple[int, ...]


class MaskedSteps(_AttemptModel):
    """Steps that the ground-truth check of a protocol takes from every planner, regardless of the plan.

    Attributes:
        adversary: The recorded ego touches an adversary there, as the protocol sees both.
        others: It touches something else and no adversary.
    """

    adversary: int
    others: int


class Attempt(_AttemptModel):
    """One vehicle of one recorded scene that was tried as an adversary.

    Attributes:
        discard: Why not (`generation.search.verify.DiscardReason`).
        because: Evidence of that (`generation.search.verify.VerificationFailure`).
        tries: Searches that were made; everything else is about the last one.
        challenge: Ranking score, see `generation.search.ranking.compute_challenge_score`; 0 where discarded.
        closest_approach: Closest approach, where the track is complete.
        least_time_to_collision_s: Smallest time to collision, ``None`` if never within 5 s.
        masked_steps: By protocol, if kept: steps of all samples that are masked for any plan.
        judgements: If verification passed: judgements of each adversary that the scene has by then, its own last; empty
            in older files.
        earlier: Adversaries that the scene had already.
        dropped: Why an attempt that passed verification is not written (`generation.search.chains.DropReason`).
        written: Name of the scene that it became.
        asked: Kind of manoeuvre that was asked for (``generate --manoeuvre``), if one was.
    """

    scene: str
    agent: str
    seed: int
    kept: bool
    discard: str | None
    because: dict[str, Any] | None = None
    launch_frame: int | None
    tries: int = 1
    challenge: float
    closest_approach: Approach | None
    least_time_to_collision_s: float | None
    labels: ManoeuvreLabels | None = None
    masked_steps: dict[str, MaskedSteps] = Field(default_factory=dict)
    judgements: tuple[SceneAssessment, ...] = ()
    plans: tuple[PlanningFrame, ...] = ()
    earlier: tuple[str, ...] = ()
    dropped: str | None = None
    written: str | None = None
    asked: str | None = None


def read_attempts(path: Path) -> tuple[Attempt, ...]:
    """Attempts of an ``attempts.jsonl`` of this version or an older one, in their order."""

    def attempt(number: int, row: Any) -> Attempt:
        return validate_stored(
            Attempt.model_validate,
            row,
            lambda where, _: f"{path} line {number} lacks a proper {where or 'object'}; generate the split again",
        )

    return tuple(attempt(number, row) for number, row in enumerate(read_json_lines(path), start=1))


def list_adversary_reports(report: Any) -> list[dict[str, Any]]:
    """Reports on each adversary of a scene: the report itself, or those below its ``adversaries``; any JSON value."""
    several = report.get("adversaries") if isinstance(report, dict) else None
    reports = several if isinstance(several, list) else [report]
    return [entry for entry in reports if isinstance(entry, dict)]


def list_stored_labels(report: Any) -> list[Any]:
    """Labels of each adversary that has any, as ``challenger.json`` has them, not checked (`ManoeuvreLabels`).

    Args:
        report: Report on a scene: on its adversary, or on each of several below ``adversaries``; any JSON value, as it
            comes from a stranger's data set.
    """
    labels = (entry.get("labels") for entry in list_adversary_reports(report))
    return [stored for stored in labels if stored is not None]


_NAMED: Final = re.compile(r"adv-seed-(0|[1-9]\d{0,17})")
SEARCH: Final = "search"
"""In ``challenger.json`` of such a split: hash of everything but the seed that decided its search."""


def format_seed_split(seed: int) -> str:
    """Name of the split that is searched with a seed."""
    return f"adv-seed-{seed}"


def parse_seed(split: str) -> int | None:
    """Seed of a split that is called after one, else ``None``."""
    named = _NAMED.fullmatch(split)
    return int(named[1]) if named else None


def is_adversarial(split: str) -> bool:
    """Whether a split is ``adv``, or one of those of several seeds."""
    return split == "adv" or parse_seed(split) is not None


def read_generated_facts(made: Mapping[str, Any] | None) -> GeneratedFacts | None:
    """Which search a data set's scenes come from; ``None`` where they say no seed, or several.

    Args:
        made: What ``challenger.json`` says of the data set, if there is one.
    """
    scenes = made.get("scenes") if isinstance(made, Mapping) else None
    seeds = set()
    for entry in scenes.values() if isinstance(scenes, dict) else ():
        for report in list_adversary_reports(entry.get("report")):
            seeds.add(report.get("seed"))
    if len(seeds) != 1 or type(seed := next(iter(seeds))) is not int or not 0 <= seed < 1 << 63:
        return None
    search = made.get(SEARCH) if isinstance(made, Mapping) else None
    return GeneratedFacts(seed=seed, search=search if isinstance(search, str) and len(search) <= 64 else None)
