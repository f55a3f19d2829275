"""What a challenge says of an entry: the verdict of ``challenge check``, scene by scene, with reasons."""

from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from benchmark.machine.storage import read_json, write_json
from benchmark.records.store import validated
from benchmark.records.stored import Stored

VERDICT_FILE: Final = "verdict.json"
VERDICT_FORMAT: Final = "challenger-bench challenge verdict"


class Reason(Stored):
    """Why a scene, or a whole entry, is refused.

    Attributes:
        rule: Of ``rules.toml``, as ``table.name``.
        sentence: What was found, where, against what was allowed.
    """

    rule: str
    sentence: str


class ChangedVehicle(Stored):
    """A vehicle that differs from the recording, from ``from_s`` on; times since the scene's first keyframe.

    Attributes:
        instance: Token in the entry.
        recorded: Token in the recording.
        farthest_m: Largest distance from where it was recorded.
        least_gap_ego_m: Distance to the recorded ego, from there on; ``None`` where it was not measured.
        least_gap_others_m: Distance to the nearest of all others; ``None`` where it was not measured or none is near.
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

    Attributes:
        notes: What could not be asked, and what else an organiser may want to know; no reason to refuse it.
        changed: Vehicles that differ from the recording; those that are let be first.
        images: Images that were looked at.
    """

    scene: str
    recording: str
    reasons: tuple[Reason, ...] = ()
    notes: tuple[str, ...] = ()
    changed: tuple[ChangedVehicle, ...] = ()
    images: int = 0

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.reasons


class ComparedData(Stored):
    """A data set that took part: its name and the hash of its content."""

    name: str
    fingerprint: str


class EntryVerdict(Stored):
    """Verdict on an entry.

    Attributes:
        rules: Fingerprint of its rules: verdicts by others are not comparable.
        reasons: Why the entry as a whole is refused.
    """

    format: Literal["challenger-bench challenge verdict"] = VERDICT_FORMAT
    schema_version: Literal[1] = Field(default=1, alias="schema")
    version: str
    entry: ComparedData
    base: ComparedData
    challenge: str
    rules: str
    reasons: tuple[Reason, ...] = ()
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
    return validated(
        EntryVerdict.model_validate,
        read_json(path),
        lambda where, why: f"{path} is damaged at {where or 'its top'}: {why}; run challenge check again",
    )
