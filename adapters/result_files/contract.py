"""Contract of a family of result files: plans in the file's own frame, and the sample of each."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from adapters.result_files.samples import RecordedSamples
from benchmark.geometry import Floats
from benchmark.records.run_schema import SampleOrder
from benchmark.untrusted.files import Category, RefusedFileError, to_one_line

Rows = NDArray[np.int64]
LONG_PLAN_STEPS: Final = 12
"""Steps of the planners that were trained for 6 s."""


LACKS: Final = ("forecasts of others", "alternatives with scores", "speed of the planner", "plans beyond 3 s")
"""Facts that no format gives: some hold the first two, in undocumented forms."""
ROUNDED: Final = (*LACKS, "positions finer than 0.01 m")
"""The same of texts."""


class FileFrame(StrEnum):
    """Frame of a file's waypoints.

    ``lidar``: x right, y forward, positions of the lidar. ``displacement``: x forward, y left, positions of the lidar
    less its position now. ``ego``: x forward, y left, positions of the rear axle.
    """

    LIDAR = "lidar"
    DISPLACEMENT = "displacement"
    EGO = "ego"


@dataclass(frozen=True, slots=True)
class FilePlans:
    """Plans of one file.

    Attributes:
        rows: (N,) sample of each plan, in the order of the file.
        waypoints: (N, K, 2) positions, metres; K is 6, or 12 of planners that plan 6 s.
        shown_by: Evidence of the order, in words that fit behind "the order is proven: ".
        skipped: Samples without a readable plan, and why, by token.
        repaired: Plans that the repository itself completes because the answer was too short or too long.
        mirrored: Whether x of the file is mirrored, where a file may be either.
    """

    frame: FileFrame
    rows: Rows
    waypoints: Floats
    order: SampleOrder
    shown_by: str
    skipped: Mapping[str, str] = field(default_factory=dict)
    duplicates: int = 0
    repaired: int = 0
    mirrored: bool | None = None


@dataclass(frozen=True, slots=True)
class ResultFormat:
    """One format, named as ``--format`` takes it.

    `read` raises `RefusedFileError`. `lacks` are facts that the record lacks, in words that fit behind "the record has
    no ". `by_place`: samples are known by their place in the list alone.
    """

    name: str
    repositories: str
    native: str | None
    read: Callable[[Path, Any, RecordedSamples], FilePlans]
    lacks: tuple[str, ...] = LACKS
    by_place: bool = False

    @property
    def planners(self) -> frozenset[str]:
        """Planners whose repositories write it, in lower case."""
        names = re.sub(r"\(.*?\)", "", self.repositories).split(",")
        return frozenset(name.strip().lower() for name in names)


def refuse(path: Path, category: Category, what: str, advice: str) -> NoReturn:
    """Raise the refusal of a file: what is wrong with it, and what to do."""
    raise RefusedFileError(category, f"{path}: {what}; {advice}")


def find_rows(path: Path, tokens: list[Any], samples: RecordedSamples) -> Rows:
    """Rows of (N,) samples by foreign tokens; one that is no sample of the data, or none at all, is refused."""
    if not tokens:
        refuse(path, "empty", "it has no entries", "run the planner again")
    known = samples.row_of
    for token in tokens:
        if not isinstance(token, str):
            refuse(
                path, "token", f"it names a sample {to_one_line(token, 40)!r}, which is not a token", "make it again"
            )
    unknown = [token for token in tokens if token not in known]
    if unknown:
        which = f"{len(unknown)} of its {len(tokens)} samples, the first {to_one_line(unknown[0], 64)!r},"
        other = None if samples.others is None else samples.others.first(lambda tokens: unknown[0] in tokens)
        if other is not None:
            fault = f"{which} are samples of split {other!r}, not of {samples.name}"
            refuse(path, "token", fault, f"score it with --split {other}")
        advice = "name the data and the split that the planner ran on with --data and --split"
        refuse(path, "token", f"{which} are none of {samples.name}", advice)
    return np.array([known[token] for token in tokens], np.int64)


def refuse_duplicates(path: Path, rows: Rows, samples: RecordedSamples) -> None:
    """Refuse a file with a sample twice."""
    distinct, counts = np.unique(rows, return_counts=True)
    if (counts > 1).any():
        token = samples.tokens[int(distinct[counts > 1][0])]
        refuse(path, "duplicate", f"it holds sample {token} {counts.max()} times", "make it again from one run")


def read_numbers(path: Path, value: Any, where: str, *shapes: tuple[int | None, ...]) -> Floats:
    """Foreign numbers of one of some shapes (``None``: any length), finite, in double precision."""
    expected = " or ".join(" x ".join("any" if length is None else str(length) for length in shape) for shape in shapes)
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.zeros(0, np.str_)
    fits = any(
        array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
        for shape in shapes
    )
    is_numeric = array.dtype.kind in "fiu" and not _has_booleans(value)
    if not is_numeric or not fits:
        have = " x ".join(map(str, array.shape)) if is_numeric else f"{type(value).__name__} of no numbers"
        refuse(path, "shape", f"{where} is {have}, not {expected}", "make the file again with the official script")
    numbers: Floats = array.astype(np.float64)
    if not np.isfinite(numbers).all():
        refuse(path, "not_finite", f"{where} contains NaN or infinity", "a plan without numbers is none: leave it out")
    return numbers


def _has_booleans(value: Any) -> bool:
    """Whether nested lists hold booleans, which would count as 1 and 0 metres."""
    if isinstance(value, list | tuple):
        return any(_has_booleans(element) for element in value)
    return isinstance(value, bool)


def read_key(path: Path, entry: Any, key: str, where: str) -> Any:
    """A value of a foreign dictionary; refuses one that lacks it."""
    if not isinstance(entry, dict) or entry.get(key) is None:
        refuse(path, "shape", f"{where} has no {key}", "make the file again with the official script")
    return entry[key]
