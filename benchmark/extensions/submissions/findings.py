"""What a check of a submission finds."""

from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any


class Level(StrEnum):
    """Meaning of a finding.

    An error keeps a record out. ``suspicious`` marks a behaviour that honest planners were never seen to show, and
    proves nothing. A note is for the reader.
    """

    ERROR = "error"
    SUSPICIOUS = "suspicious"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a submission, or a remark on it.

    Attributes:
        directory: Of the record, or of the submission.
        level: Whether it keeps the record out.
        sentence: The fault, and its remedy.
    """

    directory: Path
    level: Level
    sentence: str

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"directory": str(self.directory)}


Said = tuple[Level, str]
"""A finding about a record whose directory is known."""
