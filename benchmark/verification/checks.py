"""What `challenger-bench verify` compares and prints: one line per quantity, the largest error and what is allowed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, wrap_angle
from benchmark.report.table import table_of
from benchmark.report.words import counted

ROUNDING: Final = "as far as our own rounding moves it"
AS_FAR: Final = 3.0
"""Errors of up to so many times what rounding was seen to move: two runs do not see the worst that it does."""


@dataclass(frozen=True, slots=True)
class Check:
    """One quantity compared with its golden values.

    Attributes:
        quantity: Name, with unit where it has one.
        error: Largest difference; for verdicts, the number of wrong ones.
        tolerance: Largest difference that is allowed.
        count: Values compared.
        note: What else a reader should know, for example what was left out and why.
        moved: By how much our own rounding moves it, where that was measured (`Comparison.moved_by`).
    """

    quantity: str
    error: float
    tolerance: float
    count: int
    note: str = ""
    moved: float | None = None

    @property
    def ok(self) -> bool:
        """Whether the error is allowed; NaN never is, and nothing compared is not a success."""
        return bool(self.count > 0 and np.isfinite(self.error) and self.error <= self.tolerance)

    @property
    def rounding(self) -> bool:
        """Whether the error is past its tolerance, and no further than our own rounding moves the quantity."""
        known = self.moved is not None and self.moved > 0 and self.count > 0 and not np.isnan(self.error)
        return bool(known and not self.ok and self.error <= AS_FAR * (self.moved or 0.0))

    @property
    def passes(self) -> bool:
        """Whether nothing is wrong that is known to be wrong."""
        return self.ok or self.rounding

    @property
    def verdict(self) -> str:
        """In words."""
        return "ok" if self.ok else ROUNDING if self.rounding else "FAIL"

    def as_json(self) -> dict[str, Any]:
        """JSON values; an error that is not finite is ``null``, because JSON has no word for it."""
        return {
            **self._plain(),
            **({} if self.moved is None else {"verdict": self.verdict, "moved": _finite(self.moved)}),
        }

    def _plain(self) -> dict[str, Any]:
        return {
            "quantity": self.quantity,
            "ok": self.ok,
            "error": _finite(self.error),
            "tolerance": self.tolerance,
            "count": self.count,
            "note": self.note,
        }


def _finite(number: float) -> float | None:
    return number if np.isfinite(number) else None


def report(checks: Sequence[Check]) -> str:
    """One row a quantity, notes on them, and a closing sentence; with how far rounding moves each, where it is known.

    Args:
        checks: In the order to print.

    Returns:
        Lines of text.
    """
    told = any(check.moved is not None for check in checks)
    rows = [
        (
            check.verdict,
            check.quantity,
            f"{check.error:.3g}",
            f"{check.tolerance:.3g}",
            *((f"{check.moved or 0.0:.3g}",) if told else ()),
            f"{check.count:,}",
        )
        for check in checks
    ]
    failed, rounded = sum(not check.ok for check in checks), sum(check.rounding for check in checks)
    said = f", {rounded} {ROUNDING}" if rounded else ""
    table = table_of(
        "checks",
        "",
        ("", "quantity", "largest error", "allowed", *(("own rounding",) if told else ()), "values"),
        rows,
        notes=[f"{check.quantity}: {check.note}." for check in checks if check.note],
        text_columns=2,
    )
    return f"{table.plain()}{len(checks) - failed} of {counted(len(checks), 'quantity')} agree{said}"


def _apart(sizes: list[NDArray[Any]], others: list[NDArray[Any]]) -> float:
    """Largest difference of two errors, or how many verdicts differ."""
    if sizes and sizes[0].dtype == np.bool_:
        return float(sum(np.count_nonzero(ours != theirs) for ours, theirs in zip(sizes, others)))
    with np.errstate(invalid="ignore"):
        apart = [np.max(np.abs(ours - theirs), initial=0.0) for ours, theirs in zip(sizes, others)]
    # Two infinite errors, of lists of other lengths, are as far apart as none.
    return float(np.nan_to_num(np.max(apart, initial=0.0), nan=0.0, posinf=np.inf))


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
        self._sizes: dict[str, list[NDArray[Any]]] = {}
        self.remembers = False
        """Whether sizes of errors are kept, for `moved_by`."""

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
        self._keep(quantity, size)
        self._worst(quantity, float(size.max(initial=0.0)), size.size, tolerance, where)

    def errors(self, quantity: str, sizes: NDArray[Any], tolerance: float, *, where: str = "") -> None:
        """Take the sizes of errors that were computed elsewhere; arguments as in `numbers`."""
        self._keep(quantity, np.abs(sizes))
        self._worst(quantity, float(np.max(np.abs(sizes), initial=0.0)), np.size(sizes), tolerance, where)

    def verdicts(self, quantity: str, wrong: Bools, *, where: str = "") -> None:
        """Count wrong verdicts; none is allowed.

        Args:
            quantity: Name.
            wrong: Any shape, one for each verdict compared.
            where: File or batch, named in the note if it is the last one with wrong verdicts.
        """
        self._keep(quantity, np.asarray(wrong, np.bool_))
        tally = self._tallies.setdefault(quantity, _Tally(0.0))
        count = int(np.count_nonzero(wrong))
        tally.error += count
        tally.count += int(np.size(wrong))
        tally.worst_in = where if count else tally.worst_in

    def moved_by(self, other: "Comparison") -> dict[str, float]:
        """How far apart two comparisons of the same network are that differ by rounding alone.

        An error of one and the error of the other differ by no more than the two values do, and sorting keeps that, so
        this is never more than how far rounding really moves a quantity.

        Args:
            other: Of the same golden numbers, in the same order; both remember.

        Returns:
            By quantity the largest difference of two errors; of verdicts, how many differ. It is infinite where another
            number of values was compared.
        """
        moved = {}
        for quantity, sizes in self._sizes.items():
            others = other._sizes.get(quantity, [])
            alike = len(sizes) == len(others) and all(a.shape == b.shape for a, b in zip(sizes, others))
            moved[quantity] = _apart(sizes, others) if alike else float("inf")
        return moved

    def _keep(self, quantity: str, sizes: NDArray[Any]) -> None:
        if self.remembers:
            self._sizes.setdefault(quantity, []).append(np.array(sizes))

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
