"""How the entries of a challenge rank: what ``challenge score`` writes and the leaderboard shows."""

from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from benchmark.machine.storage import file_name, read_json, write_json
from benchmark.records.challenge import ComparedData, Reason
from benchmark.records.run_schema import PlannerFacts
from benchmark.records.store import read_each, validated
from benchmark.records.stored import Stored

SCORES_FORMAT: Final = "challenger-bench challenge scores"
_PATTERN: Final = "scores-*.json"
Rank = Literal["adversary", "collision"]
"""Which of its rates an entry is ranked by."""


class Measured(Stored):
    """A number with its 95 % interval over recordings.

    Attributes:
        value: ``None`` where it does not exist.
        low: ``None`` where fewer than two recordings count.
        denominator: How many samples, scenes or contacts it was counted over.
    """

    value: float | None = None
    low: float | None = None
    high: float | None = None
    denominator: int = 0


class PlannerOnEntry(Stored):
    """One planner on one entry; refused scenes count as scenes on which it collides nowhere.

    Attributes:
        adversary: Share of samples with a first contact with a changed vehicle, under ``exact``; no number in older
            files, and where a record does not say whom contacts are with.
        collision: Share of samples with a collision under the protocol, with any vehicle or person.
        attributable: Share with a contact that is its fault, where the careful human survives the scene.
        failed: Samples without a plan; they are in no rate.
    """

    adversary: Measured = Measured()
    collision: Measured
    attributable: Measured
    failed: int


class EntryScore(Stored):
    """Scores of one entry; rates are means over the planners, shares are of the accepted scenes.

    Attributes:
        refused: Names of the scenes that are refused.
        reasons: Why it is not ranked as a whole; none if it is.
        best_place: Its best place that the numbers leave open; ``None`` if it is not ranked.
        adversary: First contacts with a changed vehicle, under ``exact``.
        collision: Contacts with anything, under the protocol.
        least_gap_m: Distance of the recorded ego from the changed vehicles, mean over accepted scenes.
        critical: Share of accepted scenes in which the two are ever within 1.5 s of contact at constant velocities.
        delta_v_m_s: Change of velocity of the ego where a plan first touches a changed vehicle, mean over all planners;
            of contacts with anything in older files.
        without_fault: Share of accepted scenes in whose tracks no fault was found (``docs/realism.md``).
        realism_feature: The worst of the features of motion that are compared with recordings.
        realism: 1 less its divergence: the larger, the more real.
    """

    entry: ComparedData
    scenes: int
    refused: tuple[str, ...] = ()
    reasons: tuple[Reason, ...] = ()
    best_place: int | None = None
    worst_place: int | None = None
    adversary: Measured = Measured()
    collision: Measured
    attributable: Measured
    planners: dict[str, PlannerOnEntry] = Field(default_factory=dict)
    careful_survives: Measured
    least_gap_m: Measured
    critical: Measured
    delta_v_m_s: Measured
    without_fault: Measured
    realism_feature: str | None = None
    realism: Measured
    not_compared: str | None = None


class Pair(Stored):
    """Two ranked entries, the one with the higher score first.

    Attributes:
        difference: First less second, in resamples of the same recordings.
        told_apart: Whether the interval leaves zero out.
    """

    first: str
    second: str
    difference: Measured
    told_apart: bool


class ChallengeScores(Stored):
    """Entries of a challenge, best first, those that are not ranked last.

    Attributes:
        rules: Fingerprint of its rules.
        horizon: ``1s``, ``2s``, ``3s`` or ``avg``.
        ranks: Which of its rates an entry is ranked by; ``collision`` in older files and under another protocol than
            ``exact``.
        pairs: Of the ranked ones.
    """

    format: Literal["challenger-bench challenge scores"] = SCORES_FORMAT
    schema_version: Literal[1] = Field(default=1, alias="schema")
    version: str
    challenge: str
    rules: str
    base: ComparedData
    protocol: str
    horizon: str
    ranks: Rank = "collision"
    planners: tuple[PlannerFacts, ...]
    entries: tuple[EntryScore, ...]
    pairs: tuple[Pair, ...] = ()


def write_scores(folder: Path, scores: ChallengeScores) -> Path:
    """Write the scores of a challenge; a challenge of the same name is replaced."""
    path = folder / f"scores-{file_name(scores.challenge)}.json"
    write_json(path, scores.model_dump(mode="json", by_alias=True))
    return path


def read_scores(path: Path) -> ChallengeScores:
    """Read the scores of a challenge."""
    return validated(
        ChallengeScores.model_validate,
        read_json(path),
        lambda where, why: f"{path} is damaged at {where or 'its top'}: {why}; run challenge score again",
    )


def find_scores(folder: Path) -> list[ChallengeScores]:
    """Scores of every challenge in a folder, which need not exist, in the order of their files."""
    return read_each(sorted(folder.glob(_PATTERN)), read_scores)
