"""What is found in files that are to be published."""

from dataclasses import asdict, dataclass
from typing import Literal

Kind = Literal["path", "host", "user", "secret", "picture", "request", "link", "name"]


@dataclass(frozen=True, slots=True, order=True)
class Found:
    """One thing that should not leave the house, or that does not work elsewhere.

    `file` is below the folder, ``/`` between parts; empty where it is about several. Lines count from 1; 0 where there
    are none.
    """

    file: str
    line: int
    kind: Kind
    says: str

    def sentence(self) -> str:
        """Sentence for a terminal."""
        where = f"{self.file}:{self.line}: " if self.line else f"{self.file}: " if self.file else ""
        return f"{self.kind}: {where}{self.says}"

    def as_json(self) -> dict[str, str | int]:
        """JSON for machines."""
        return asdict(self)
