"""Faults, the list that keeps them few enough to read, and the refusal of whoever needs a data set without any."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

from benchmark.errors import InputError
from benchmark.untrusted.files import one_line

Severity = Literal["error", "warning"]

SHOWN_PER_KIND: Final = 5
"""Faults of one kind in one table that are told one by one; the rest are counted."""
_LONGEST: Final = 1000
"""Characters of a sentence: a fault may quote what a stranger wrote."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with a data set.

    Attributes:
        table: Table or file that it was found in.
        token: Token of the row, or an empty string.
        sentence: What is wrong.
        severity: ``error``: software that follows the format crashes or computes something wrong. ``warning``: legal,
            but most likely not meant.
    """

    table: str
    token: str
    sentence: str
    severity: Severity = "error"


@dataclass(slots=True)
class FaultList:
    """Collects faults; of each kind in each table the first few are kept and the rest counted."""

    faults: list[Fault] = field(default_factory=list)
    counts: Counter[tuple[str, str, Severity]] = field(default_factory=Counter)

    def add(self, kind: str, table: str, token: str, sentence: str, *, severity: Severity = "error") -> None:
        """Note a fault.

        Args:
            kind: Two or three words for what the faults of a kind have in common; names them when counted.
            token: Token of the row, or an empty string.
        """
        self.counts[(kind, table, severity)] += 1
        if self.counts[(kind, table, severity)] <= SHOWN_PER_KIND:
            self.faults.append(Fault(table, token, one_line(sentence, _LONGEST), severity))

    def told(self) -> list[Fault]:
        """The faults, errors first, each kind that was cut short ended by how many more there are."""
        more = [
            Fault(table, "", f"and {count - SHOWN_PER_KIND} more: {kind}", severity)
            for (kind, table, severity), count in self.counts.items()
            if count > SHOWN_PER_KIND
        ]
        return sorted([*self.faults, *more], key=lambda fault: fault.severity)


@dataclass(slots=True)
class Refusal(FaultList):
    """Refuses at the first error; warnings are for those who ask for them."""

    folder: Path = Path()

    def add(self, kind: str, table: str, token: str, sentence: str, *, severity: Severity = "error") -> None:
        """Raise for an error."""
        if severity == "warning":
            return
        path = self.folder / (table if table.endswith(".json") else f"{table}.json")
        place = f"{path} row {token}" if token else str(path)
        raise InputError(
            f"{place}: {sentence}; correct the data set (to see all faults, run challenger-bench data check "
            f"{self.folder.parent})"
        )
