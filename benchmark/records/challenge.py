"""Records of a challenge: the verdict of ``challenge check`` on an entry, and the ranking of ``challenge score``."""

from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from benchmark.machine.storage import read_json, sanitise_file_name, write_json
from benchmark.records.run_schema import PlannerFacts
from benchmark.records.store import read_records, validate_stored
from benchmark.records.stored import Stored

VERDICT_FILE: Final = "verdict.json"
VERDICT_FORMAT: Final = "challenger-bench challenge verdict"


class RefusalReason(Stored):
    """Why a scene, or a whole entry, is refused: ``table.name`` of ``rules.toml``, and what was found against it.

    Attributes:
        rule: Which rule.
        sentence: What breaks it.
    """

    rule: str
    sentence: str


class ChangedVehicle(Stored):
    """A vehicle that differs from the recording, from ``from_s`` on; times since the scene's first keyframe.

    ``instance`` and ``recorded`` are its tokens in the entry and in the recording, ``farthest_m`` its largest distance
    from where it was recorded. Least gaps are those from ``from_s`` on, to the recorded ego and to the nearest other;
    ``None`` where none was measured or none is near.

    Attributes:
        category: In nuScenes' words.
        least_gap_ego_m: To the recorded ego.
        least_gap_others_m: To the nearest other.
        nearest_ego_s: When it is nearest to the ego.
    """

    instance: str
    recorded: str
    category: str
    from_s: float
    farthest_m: float
    least_gap_ego_m: float | None
    least_gap_others_m: float | None
    nearest_ego_s: float | None = None


class SceneVerdict(Stored):
    """Verdict on one scene of an entry; without ``reasons`` it is accepted.

    ``notes`` say what could not be asked and what else an organiser may want to know; they refuse nothing. Of the
    ``changed`` vehicles, those that are let be come first. ``images`` is how many were looked at.

    Attributes:
        scene: Of the entry.
        recording: Recorded scene that it is compared with.
    """

    scene: str
    recording: str
    reasons: tuple[RefusalReason, ...] = ()
    notes: tuple[str, ...] = ()
    changed: tuple[ChangedVehicle, ...] = ()
    images: int = 0

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.reasons


class ComparedData(Stored):
    """A data set that took part: its name and the hash of its content.

    Attributes:
        name: Of the data set.
        fingerprint: Hash of its content.
    """

    name: str
    fingerprint: str


class EntryVerdict(Stored):
    """Verdict on an entry, refused as a whole for ``reasons``; verdicts by other ``rules`` are not comparable.

    Attributes:
        format: Marks the file.
        schema_version: Version of the format.
        version: Of challenger-bench.
        entry: Data set that was checked.
        base: Recordings that it is compared with.
        challenge: Its name.
        scenes: Verdict on each scene.
    """

    format: Literal["challenger-bench challenge verdict"] = VERDICT_FORMAT
    schema_version: Literal[1] = Field(default=1, alias="schema")
    version: str
    entry: ComparedData
    base: ComparedData
    challenge: str
    rules: str
    reasons: tuple[RefusalReason, ...] = ()
    scenes: tuple[SceneVerdict, ...]

    @property
    def refused(self) -> tuple[SceneVerdict, ...]:
        """Scenes that are refused."""
        return tuple(scene for scene in self.scenes if not scene.accepted)

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against the entry and any of its scenes."""
        return not self.reasons and not self.refused


def write_verdict(folder: Path, verdict: EntryVerdict) -> Path:
    """Write the verdict on an entry into a folder."""
    path = folder / VERDICT_FILE
    write_json(path, verdict.model_dump(mode="json", by_alias=True))
    return path


def read_verdict(path: Path) -> EntryVerdict:
    """Read a verdict on an entry."""
    return validate_stored(
        EntryVerdict.model_validate,
        read_json(path),
        lambda where, why: f"{path} is damaged at {where or 'its top'}: {why}; run challenge check again",
    )


SCORES_FORMAT: Final = "challenger-bench challenge scores"
_PATTERN: Final = "scores-*.json"
Rank = Literal["adversary", "collision"]
"""Which of its rates an entry is ranked by."""


class ScoredQuantity(Stored):
    """A number with its 95 % interval over recordings; ``None`` where it does not exist.

    The interval needs two recordings. ``denominator`` is how many samples, scenes or contacts it was counted over.

    Attributes:
        value: The number.
        low: Lower end of the interval.
        high: Upper end.
    """

    value: float | None = None
    low: float | None = None
    high: float | None = None
    denominator: int = 0


class PlannerEntryScore(Stored):
    """One planner on one entry; refused scenes count as scenes on which it collides nowhere.

    ``adversary`` is the share of samples with a first contact with a changed vehicle, under ``exact``; no number in
    older files, and where a record does not say whom contacts are with. ``collision`` is the share with a contact with
    anything under the protocol, ``attributable`` with one that is its fault, where the careful human survives the
    scene. ``failed`` samples have no plan and are in no rate.
    """

    adversary: ScoredQuantity = ScoredQuantity()
    collision: ScoredQuantity
    attributable: ScoredQuantity
    failed: int


class EntryScore(Stored):
    """Scores of one entry; rates are means over the planners, shares are of the accepted scenes.

    Attributes:
        entry: Data set of the entry.
        scenes: How many it has.
        refused: Names of the scenes that are refused.
        reasons: Why it is not ranked as a whole; none if it is.
        best_place: Its best place that the numbers leave open; ``None`` if it is not ranked.
        worst_place: Its worst place that the numbers leave open.
        adversary: First contacts with a changed vehicle, under ``exact``.
        collision: Contacts with anything, under the protocol.
        attributable: Contacts at the planner's fault where the careful human survives.
        planners: Scores of each planner.
        careful_survives: Share of accepted scenes that the careful human survives.
        least_gap_m: Distance of the recorded ego from the changed vehicles, mean over accepted scenes.
        critical: Share of accepted scenes in which the two are ever within 1.5 s of contact at constant velocities.
        delta_v_m_s: Change of velocity of the ego where a plan first touches a changed vehicle, mean over all planners;
            of contacts with anything in older files.
        without_fault: Share of accepted scenes in whose tracks no fault was found (``docs/realism.md``).
        realism_feature: The worst of the features of motion that are compared with recordings.
        realism: 1 less its divergence: the larger, the more real.
        not_compared: Why its motion was not compared with recordings.
    """

    entry: ComparedData
    scenes: int
    refused: tuple[str, ...] = ()
    reasons: tuple[RefusalReason, ...] = ()
    best_place: int | None = None
    worst_place: int | None = None
    adversary: ScoredQuantity = ScoredQuantity()
    collision: ScoredQuantity
    attributable: ScoredQuantity
    planners: dict[str, PlannerEntryScore] = Field(default_factory=dict)
    careful_survives: ScoredQuantity
    least_gap_m: ScoredQuantity
    critical: ScoredQuantity
    delta_v_m_s: ScoredQuantity
    without_fault: ScoredQuantity
    realism_feature: str | None = None
    realism: ScoredQuantity
    not_compared: str | None = None


class EntryPair(Stored):
    """Two ranked entries, the one with the higher score first, and their difference.

    ``difference`` is taken in resamples of the same recordings; they are told apart if its interval leaves zero out.

    Attributes:
        first: Name of one entry.
        second: Name of the other.
        told_apart: Whether the interval leaves zero out.
    """

    first: str
    second: str
    difference: ScoredQuantity
    told_apart: bool


class ChallengeScores(Stored):
    """Entries of a challenge, best first, those that are not ranked last; ``pairs`` are of ranked ones.

    ``rules`` is the fingerprint of the rules, ``horizon`` ``1s``, ``2s``, ``3s`` or ``avg``. ``ranks`` is the rate that
    an entry is ranked by: ``collision`` in older files and under another protocol than ``exact``.

    Attributes:
        format: Marks the file.
        schema_version: Version of the format.
        version: Of challenger-bench.
        challenge: Its name.
        base: Recordings of the challenge.
        protocol: Protocol of the collision rate.
        planners: Planners that were run.
        entries: Scores of each entry.
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
    pairs: tuple[EntryPair, ...] = ()


def write_scores(folder: Path, scores: ChallengeScores) -> Path:
    """Write the scores of a challenge; a challenge of the same name is replaced."""
    path = folder / f"scores-{sanitise_file_name(scores.challenge)}.json"
    write_json(path, scores.model_dump(mode="json", by_alias=True))
    return path


def read_scores(path: Path) -> ChallengeScores:
    """Read the scores of a challenge."""
    return validate_stored(
        ChallengeScores.model_validate,
        read_json(path),
        lambda where, why: f"{path} is damaged at {where or 'its top'}: {why}; run challenge score again",
    )


def find_scores(folder: Path) -> list[ChallengeScores]:
    """Scores of every challenge in a folder, which need not exist, in the order of their files."""
    return read_records(sorted(folder.glob(_PATTERN)), read_scores)
