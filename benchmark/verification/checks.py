"""What `challenger-bench verify` compares and prints: one line per quantity, the largest error and what is allowed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, wrap_angle
from benchmark.report.table import table_of
from benchmark.report.words import counted


@dataclass(frozen=True, slots=True)
class Check:
    """One quantity compared with its golden values.

    Attributes:
        quantity: Name, with unit where it has one.
        error: Largest difference; for verdicts, the number of wrong ones.
        tolerance: Largest difference that is allowed.
        count: Values compared.
        note: What else a reader should know, for example what was left out and why.
    """

    quantity: str
    error: float
    tolerance: float
    count: int
    note: str = ""

    @property
    def ok(self) -> bool:
        """Whether the error is allowed; NaN never is, and nothing compared is not a success."""
        return bool(self.count > 0 and np.isfinite(self.error) and self.error <= self.tolerance)

    def as_json(self) -> dict[str, Any]:
        """JSON values; an error that is not finite is ``null``, because JSON has no word for it."""
        return {
            "quantity": self.quantity,
            "ok": self.ok,
            "error": self.error if np.isfinite(self.error) else None,
            "tolerance": self.tolerance,
            "count": self.count,
            "note": self.note,
        }


def report(checks: Sequence[Check]) -> str:
    """One row a quantity, notes on them, and a closing sentence.

    Args:
        checks: In the order to print.

    Returns:
        Lines of text.
    """
    rows = [
        (
            "ok" if check.ok else "FAIL",
            check.quantity,
            f"{check.error:.3g}",
            f"{check.tolerance:.3g}",
            f"{check.count:,}",
        )
        for check in checks
    ]
    failed = sum(not check.ok for check in checks)
    table = table_of(
        "checks",
        "",
        ("", "quantity", "largest error", "allowed", "values"),
        rows,
        notes=[f"{check.quantity}: {check.note}." for check in checks if check.note],
        text_columns=2,
    )
    return f"{table.plain()}{len(checks) - failed} of {counted(len(checks), 'quantity')} agree"


@dataclass(slots=True)
class _Tally:
    """What is known about one quantity so far."""

    tolerance: float
    error: float = 0.0
    count: int = 0
    worst_in: str = ""
    notes: list[str] = field(default_factory=list)


class Comparison:
    """Gathers the errors of quantities over files and batches into one `Check` each, in order of first mention."""

    def __init__(self) -> None:
        self._tallies: dict[str, _Tally] = {}

    def numbers(
        self,
        quantity: str,
        ours: NDArray[Any],
        golden: NDArray[Any],
        tolerance: float,
        *,
        angle: bool = False,
        where: str = "",
    ) -> None:
        """Compare numbers.

        Args:
            quantity: Name, with unit.
            ours: Any shape.
            golden: The same shape.
            tolerance: Largest difference that is allowed, the same in every call for the quantity.
            angle: Whether they are radians and a full turn makes no difference.
            where: File or batch, named in the note if it has the largest error.
        """
        if np.shape(ours) != np.shape(golden):
            raise ValueError(f"{quantity}: shapes {np.shape(ours)} and {np.shape(golden)}")
        # Equal infinities would give NaN, and different ones are meant to.
        with np.errstate(invalid="ignore"):
            difference = np.asarray(ours, np.float64) - np.asarray(golden, np.float64)
            size = np.abs(wrap_angle(difference) if angle else difference)
        self._worst(quantity, float(size.max(initial=0.0)), size.size, tolerance, where)

    def errors(self, quantity: str, sizes: NDArray[Any], tolerance: float, *, where: str = "") -> None:
        """Take the sizes of errors that were computed elsewhere; arguments as in `numbers`."""
        self._worst(quantity, float(np.max(np.abs(sizes), initial=0.0)), np.size(sizes), tolerance, where)

    def verdicts(self, quantity: str, wrong: Bools, *, where: str = "") -> None:
        """Count wrong verdicts; none is allowed.

        Args:
            quantity: Name.
            wrong: Any shape, one for each verdict compared.
            where: File or batch, named in the note if it is the last one with wrong verdicts.
        """
        tally = self._tallies.setdefault(quantity, _Tally(0.0))
        count = int(np.count_nonzero(wrong))
        tally.error += count
        tally.count += int(np.size(wrong))
        tally.worst_in = where if count else tally.worst_in

    def note(self, quantity: str, text: str) -> None:
        """Add to the note of a quantity that has been compared."""
        self._tallies[quantity].notes.append(text)

    def checks(self) -> list[Check]:
        """One for each quantity; where a failed one is largest is the first thing in its note."""
        found = []
        for quantity, tally in self._tallies.items():
            check = Check(quantity, tally.error, tally.tolerance, tally.count)
            place = [f"worst in {tally.worst_in}"] if tally.worst_in and not check.ok else []
            found.append(Check(quantity, tally.error, tally.tolerance, tally.count, "; ".join([*place, *tally.notes])))
        return found

    def _worst(self, quantity: str, error: float, count: int, tolerance: float, where: str) -> None:
        tally = self._tallies.setdefault(quantity, _Tally(tolerance))
        # Written so that NaN replaces every number and no number replaces NaN.
        if not (error <= tally.error or np.isnan(tally.error)):
            tally.error, tally.worst_in = error, where
        tally.count += count
