"""Stored attempts of the search for adversaries (``attempts.jsonl``, ``challenger.json``); names of seeded splits."""

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
    """Closest approach of two bodies, in seconds since the scene's first frame, and the side of the ego.

    The side is a `generation.labels.labelling.Side`.

    Attributes:
        gap_m: Distance of the bodies.
        time_s: When it is least.
        side: Side of the ego.
    """

    gap_m: float
    time_s: float
    side: str


class ClosestApproach(Approach):
    """The moment at which two bodies are closest; ``frame`` is its index."""

    frame: int


class ManoeuvreOccurrence(_AttemptModel):
    """One kind of manoeuvre (`generation.labels.manoeuvres.Manoeuvre`) in a scene.

    ``first_s`` counts from the scene's first frame; ``duration_s`` is the sum of all its times, and ``least_gap_m`` the
    smallest gap between the bodies in them.

    Attributes:
        kind: Its name.
    """

    kind: str
    first_s: float
    duration_s: float
    least_gap_m: float


class Encroachment(_AttemptModel):
    """Closest succession of the two bodies on one and the same piece of the ego's path (post-encroachment time).

    ``seconds`` is 0 if both were there at once, as abreast in a bend. The other vehicle was there at ``time_s`` since
    the scene's first frame.

    Attributes:
        ego_first: Whether the ego was there first.
    """

    seconds: float
    ego_first: bool
    time_s: float


class TimeToCollision(_AttemptModel):
    """The smallest time to collision of a scene, and when it was that small first, seconds since the first frame.

    Attributes:
        seconds: The smallest.
        time_s: When.
    """

    seconds: float
    time_s: float


class ManoeuvreLabels(_AttemptModel):
    """Manoeuvres of one adversary towards the ego, and their place; ``docs/manoeuvres.md`` defines every word.

    ``occurred`` has the primary kind first. ``time_to_collision`` is ``None`` if it was never within 5 s.
    ``encroachment`` is ``None`` if there was none, and ``place`` the `benchmark.metrics.places.PlaceKind` of the
    closest approach.

    Attributes:
        manoeuvre: The primary kind.
        closest_approach: When the two were closest.
    """

    manoeuvre: str
    occurred: tuple[ManoeuvreOccurrence, ...]
    closest_approach: ClosestApproach
    time_to_collision: TimeToCollision | None
    encroachment: Encroachment | None
    place: str


class PlanningFrame(_AttemptModel):
    """Trace of one planning frame of the search.

    ``round`` is that of the executed candidate, and ``score`` its final score over all rounds, ``None`` if no candidate
    was finite. ``best_scores`` has the best of each round, normalised within it, ``collision_free`` its candidates
    without contact.

    Attributes:
        frame: Index in the scene.
    """

    frame: int
    round: int
    score: float | None
    best_scores: tuple[float | None, ...]
    collision_free: tuple[int, ...]


class MaskedSteps(_AttemptModel):
    """Steps that the ground-truth check of a protocol takes from every planner, regardless of the plan.

    The recorded ego touches an adversary there, as the protocol sees both, or ``others`` and no adversary.

    Attributes:
        adversary: Steps at which it is an adversary.
    """

    adversary: int
    others: int


class Attempt(_AttemptModel):
    """One vehicle of one recorded scene that was tried as an adversary.

    Attributes:
        scene: Recorded scene.
        agent: Instance that was tried.
        seed: Of the search.
        kept: Whether it passed verification.
        discard: `generation.search.verify.DiscardReason`.
        because: Evidence of that (`generation.search.verify.VerificationFailure`).
        launch_frame: 12 Hz frame from which it leaves its recording.
        tries: Searches that were made; everything else is about the last one.
        challenge: Ranking score, see `generation.search.ranking.compute_challenge_score`; 0 where discarded.
        closest_approach: ``None`` where the track is incomplete.
        least_time_to_collision_s: ``None`` if never within 5 s.
        labels: What it does.
        masked_steps: By protocol, if kept: steps of all samples that are masked for any plan.
        judgements: If verification passed: judgements of each adversary that the scene has by then, its own last; empty
            in older files.
        plans: Trace of the search.
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

    The report is on a scene's adversary, or on each of several below ``adversaries``, and any JSON value, as it comes
    from a stranger's data set.
    """
    labels = (entry.get("labels") for entry in list_adversary_reports(report))
    return [stored for stored in labels if stored is not None]


SEARCH: Final = "search"
"""In ``challenger.json`` of such a split: hash of everything but the seed that decided its search."""

EGO: Final = "ego"
"""In a root's provenance: which reference driver has the recorded ego's place, if one has."""
PANEL: Final = "panel"
"""In ``challenger.json`` of a split whose scenes were chosen by planners: their names and seeds, as text."""


def read_generated_facts(made: Mapping[str, Any] | None) -> GeneratedFacts | None:
    """Which search a data set's scenes come from, by ``challenger.json``; ``None`` if it names no seed, or several."""
    scenes = made.get("scenes") if isinstance(made, Mapping) else None
    seeds = set()
    for entry in scenes.values() if isinstance(scenes, dict) else ():
        for report in list_adversary_reports(entry.get("report")):
            seeds.add(report.get("seed"))
    if len(seeds) != 1 or type(seed := next(iter(seeds))) is not int or not 0 <= seed < 1 << 63:
        return None
    search = made.get(SEARCH) if isinstance(made, Mapping) else None
    return GeneratedFacts(seed=seed, search=search if isinstance(search, str) and len(search) <= 64 else None)
