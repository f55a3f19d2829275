"""What is found in files that are to be published."""

from dataclasses import asdict, dataclass
from typing import Literal

Kind = Literal["path", "host", "user", "secret", "picture", "request", "link", "name"]


@dataclass(frozen=True, slots=True, order=True)
class Found:
    """One thing that should not leave the house, or that does not work elsewhere.

    Attributes:
        file: Path below the folder, ``/`` between parts; empty where it is about several.
        line: Its line, from 1; 0 where there are no lines.
        kind: What it is.
        says: What was found, in a few words.
    """

    file: str
    line: int
    kind: Kind
    says: str

    def sentence(self) -> str:
        """For a terminal."""
        where = f"{self.file}:{self.line}: " if self.line else f"{self.file}: " if self.file else ""
        return f"{self.kind}: {where}{self.says}"

    def as_json(self) -> dict[str, str | int]:
        """For machines."""
        return asdict(self)
