"""Comparisons of `challenger-bench verify`: one line per quantity, the largest error and its tolerance."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.geometry import Bools, wrap_angle
from benchmark.report.table import build_table
from benchmark.report.words import pluralise

ROUNDING: Final = "within our own floating-point noise"
AS_FAR: Final = 3.0
"""Errors of up to so many times what rounding was seen to move: two runs do not see the worst that it does."""


@dataclass(frozen=True, slots=True)
class Check:
    """One quantity compared with its golden values.

    ``error`` is the largest difference; for verdicts, the number of wrong ones. ``note`` has what else a reader should
    know, for example what was left out and why; ``moved`` is by how much our own rounding moves it
    (`Comparison.moved_by`).
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


def format_report(checks: Sequence[Check]) -> str:
    """Table of a row a quantity, with notes, how far rounding moves each where it is known, and a closing sentence."""
    shows_rounding = any(check.moved is not None for check in checks)
    rows = [
        (
            check.verdict,
            check.quantity,
            f"{check.error:.3g}",
            f"{check.tolerance:.3g}",
            *((f"{check.moved or 0.0:.3g}",) if shows_rounding else ()),
            f"{check.count:,}",
        )
        for check in checks
    ]
    failed, rounded = sum(not check.ok for check in checks), sum(check.rounding for check in checks)
    rounding_note = f", {rounded} {ROUNDING}" if rounded else ""
    table = build_table(
        "checks",
        "",
        ("", "quantity", "largest error", "allowed", *(("own rounding",) if shows_rounding else ()), "values"),
        rows,
        notes=[f"{check.quantity}: {check.note}." for check in checks if check.note],
        text_columns=2,
    )
    return f"{table.plain()}{len(checks) - failed} of {pluralise(len(checks), 'quantity')} agree{rounding_note}"


def _measure_difference(sizes: list[NDArray[Any]], others: list[NDArray[Any]]) -> float:
    """Largest difference of two errors, or how many verdicts differ."""
    if sizes and sizes[0].dtype == np.bool_:
        return float(sum(np.count_nonzero(ours != theirs) for ours, theirs in zip(sizes, others)))
    with np.errstate(invalid="ignore"):
        apart = [np.max(np.abs(ours - theirs), initial=0.0) for ours, theirs in zip(sizes, others)]
    # Two infinite errors, of lists of different lengths, count as equal.
    return float(np.nan_to_num(np.max(apart, initial=0.0), nan=0.0, posinf=np.inf))


@dataclass(slots=True)
class _Tally:
    tolerance: float
    error: float = 0.0
    count: int = 0
    worst_in: str = ""
    notes: list[str] = field(default_factory=list)


class Comparison:
    """Gathers the errors of quantities over files and batches into one `Check` each, in order of first mention.

    Names in ``tolerances`` may be patterns, of which the first that fits counts.
    """

    def __init__(self, tolerances: Mapping[str, float] | None = None) -> None:
        self._tolerances = tolerances or {}
        self._tallies: dict[str, _Tally] = {}
        self._sizes: dict[str, list[NDArray[Any]]] = {}
        self.where = self._before = ""
        self.remembers = False
        """Whether sizes of errors are kept, for `moved_by`."""

    def at(self, where: str, before: str = "") -> "Comparison":
        """This comparison, for one file or batch, whose quantities have names that begin with ``before``.

        ``where`` is told in the note of a quantity that has its largest error there.
        """
        here = copy(self)
        here.where, here._before = where, self._before + before
        return here

    def numbers(
        self,
        quantity: str,
        ours: ArrayLike,
        golden: ArrayLike,
        tolerance: float | None = None,
        *,
        angle: bool = False,
        where: str = "",
    ) -> None:
        """Compare numbers of one shape; ``tolerance`` is asked where the table does not have the quantity.

        With ``angle`` they are radians, and a full turn makes no difference.
        """
        if np.shape(ours) != np.shape(golden):
            raise ValueError(f"{quantity}: shapes {np.shape(ours)} and {np.shape(golden)}")
        # Equal infinities would give NaN; different ones should.
        with np.errstate(invalid="ignore"):
            difference = np.asarray(ours, np.float64) - np.asarray(golden, np.float64)
            self.errors(quantity, wrap_angle(difference) if angle else difference, tolerance, where=where)

    def series(self, quantity: str, ours: NDArray[Any], golden: NDArray[Any]) -> bool:
        """Compare numbers of which all are wrong where there are more or fewer; whether there are as many."""
        alike = ours.shape == golden.shape
        self.errors(quantity, ours - golden if alike else np.full(max(1, golden.size), np.inf))
        return alike

    def errors(self, quantity: str, sizes: ArrayLike, tolerance: float | None = None, *, where: str = "") -> None:
        """Take the sizes of errors that were computed elsewhere; arguments as in `numbers`."""
        size = np.abs(np.asarray(sizes))
        error, tally = float(np.max(size, initial=0.0)), self._kept(quantity, size, tolerance)
        # Written so that NaN replaces every number and no number replaces NaN.
        if not (error <= tally.error or np.isnan(tally.error)):
            tally.error, tally.worst_in = error, where or self.where

    def same(self, quantity: str, ours: ArrayLike, golden: ArrayLike, of: Bools | None = None) -> None:
        """Compare values that must be equal, of all entries or of those that ``of`` flags along the first axes."""
        if np.shape(ours) != np.shape(golden):
            raise ValueError(f"{quantity}: shapes {np.shape(ours)} and {np.shape(golden)}")
        wrong = np.asarray(np.asarray(ours) != np.asarray(golden))
        self.verdicts(quantity, wrong if of is None else wrong[of])

    def verdicts(self, quantity: str, wrong: Bools | bool | list[bool], *, where: str = "") -> None:
        """Count wrong verdicts of any shape; none is allowed, and the note tells the last ``where`` with any."""
        wrong = np.asarray(wrong, np.bool_)
        count, tally = int(np.count_nonzero(wrong)), self._kept(quantity, wrong, 0.0)
        tally.error += count
        tally.worst_in = (where or self.where) if count else tally.worst_in

    def moved_by(self, other: "Comparison") -> dict[str, float]:
        """By quantity how far two errors differ at most (of verdicts, how many) where networks differ by rounding.

        An error of one and the error of the other differ by no more than the two values do, and sorting keeps that, so
        this is never more than how far rounding really moves a quantity. Both must be of the same golden numbers in the
        same order. It is infinite where another number of values was compared.
        """
        moved = {}
        for quantity, sizes in self._sizes.items():
            others = other._sizes.get(quantity, [])
            alike = len(sizes) == len(others) and all(a.shape == b.shape for a, b in zip(sizes, others))
            moved[quantity] = _measure_difference(sizes, others) if alike else float("inf")
        return moved

    def note(self, quantity: str, text: str) -> None:
        """Add to the note of a quantity that has been compared."""
        self._tallies[self._before + quantity].notes.append(text)

    def checks(self) -> list[Check]:
        """One for each quantity; where a failed one is largest is the first thing in its note."""
        results = []
        for quantity, tally in self._tallies.items():
            check = Check(quantity, tally.error, tally.tolerance, tally.count)
            place = [f"worst in {tally.worst_in}"] if tally.worst_in and not check.ok else []
            results.append(replace(check, note="; ".join([*place, *tally.notes])))
        return results

    def _kept(self, quantity: str, sizes: NDArray[Any], tolerance: float | None) -> _Tally:
        quantity = self._before + quantity
        if self.remembers:
            self._sizes.setdefault(quantity, []).append(np.array(sizes))
        if quantity not in self._tallies:
            self._tallies[quantity] = _Tally(self._get_tolerance(quantity) if tolerance is None else tolerance)
        self._tallies[quantity].count += sizes.size
        return self._tallies[quantity]

    def _get_tolerance(self, quantity: str) -> float:
        fits = (limit for name, limit in self._tolerances.items() if fnmatchcase(quantity, name))
        limit = next(fits, None)
        assert limit is not None, f"the table of quantities has no {quantity}"
        return limit
