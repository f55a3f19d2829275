"""What tables read of a record's rows, as columns: made once, a tenth of the rows' memory.

Columns that are kept in the user's cache (`benchmark.records.kept_columns`) lie in a file whose memory the system takes
back when it needs it; what is made of them anew is remembered for a few planners at a time.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, Final, Literal, overload

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, Outcomes, says_all
from benchmark.records.column_arrays import CODES, Arrays, arrays_of, different_values, outcomes_in
from benchmark.records.row_schema import DiagnosisRow, LongerRow, PlaceName, PlanSeverityRow, SampleRow

_REMEMBERED: Final = 64
"""Columns whose values are remembered: all of four planners."""


@dataclass(frozen=True, slots=True)
class BriefRow:
    """A `SampleRow` less plan, recorded motion and verdicts; ``judged`` are the protocols that have one.

    Attributes:
        recorded: Whether the recording goes on for a step at least.
        driven: Whether there are driving scores.
    """

    scene: str
    sample_token: str
    index: int
    timestamp_us: int
    status: Literal["ok", "failed"]
    command: int
    complete: bool
    recorded: bool
    place: PlaceName | None
    speed_m_s: float | None
    judged: frozenset[str]
    diagnosis: DiagnosisRow | None
    disagreements: Mapping[str, str]
    driven: bool
    longer: LongerRow | None
    severity: PlanSeverityRow | None


_MAKES: Final[Mapping[str, Callable[[Any], Any]]] = {
    # All planners of a split have the same ones.
    "scene": sys.intern,
    "sample_token": sys.intern,
    "judged": frozenset,
    "diagnosis": DiagnosisRow.model_validate,
    "longer": LongerRow.model_validate,
    "severity": PlanSeverityRow.model_validate,
}
"""Fields that are not as JSON has them."""


class RowColumns:
    """Columns of a record.

    Args:
        rows: One for each sample; they are asked again only for verdicts that do not go together in columns.
        arrays: Their columns, where they are at hand.

    Attributes:
        arrays: The columns; nobody may write to them.
        failures: Kept by `benchmark.records.run.scene_failures`, by protocol.
        kept: What others made of the columns, under a key of theirs that says all that it depends on.
    """

    def __init__(self, rows: Sequence[SampleRow], arrays: Arrays | None = None) -> None:
        self._rows = rows
        self.arrays = arrays_of(list(rows)) if arrays is None else arrays
        self._outcomes: dict[str, Outcomes] = {}
        self.failures: dict[str, dict[str, bool | None]] = {}
        self.kept: dict[Any, Any] = {}

    def __len__(self) -> int:
        return len(self.arrays["scene", CODES])

    def values(self, field: str) -> Sequence[Any]:
        """(R,) values of a field of `BriefRow`, one for each row; nobody may change the list."""
        return _values(self, field)

    def flags(self, field: str) -> Bools:
        """(R,) the same of a field that is true or false."""
        return np.array(different_values(self.arrays, (field,)), np.bool_)[self.arrays[field, CODES]]

    @property
    def brief(self) -> "BriefRows":
        """What is light of each row."""
        return BriefRows(self)

    @property
    def planned(self) -> NDArray[np.int64]:
        """(S,) places of the rows with a plan."""
        return self.arrays[("planned",)]

    @property
    def in_lidar(self) -> Floats:
        """(S, 6, 2) planned waypoints of the lidar origin of the rows in `planned`, metres."""
        return self.arrays[("in_lidar",)]

    @property
    def recorded(self) -> Floats:
        """(S, 6, 2) recorded positions of the lidar origin at the same steps, metres; NaN past the end."""
        return self.arrays[("recorded",)]

    @property
    def moved(self) -> Floats:
        """(S, 3) x, y, yaw of the recorded lidar origin half a second later; NaN past the end."""
        return self.arrays[("moved",)]

    def outcomes(self, protocol: str) -> Outcomes:
        """Verdicts of a protocol on the samples that have a plan, in their order; nobody may write to the arrays.

        Args:
            protocol: Its name.

        Returns:
            The verdicts.

        Raises:
            KeyError: If it did not judge a sample.
        """
        if protocol not in self._outcomes:
            found = outcomes_in(self.arrays, protocol)
            if found is None:
                return Outcomes.from_rows([vars(row.outcomes[protocol]) for row in self._rows if row.status == "ok"])
            self._outcomes[protocol] = found
        return self._outcomes[protocol]

    def collides(self, protocol: str) -> Bools:
        """(R,) whether a row counts under a protocol and its plan collides; rows without a plan do not."""
        found = np.zeros(len(self), np.bool_)
        outcomes = self.outcomes(protocol)
        found[self.planned] = outcomes.decided & outcomes.collision.any(axis=1)
        return found

    def counted(self, protocol: str) -> Bools:
        """(R,) whether a row counts under a known protocol, at all three horizons, and its collisions are known."""
        found = np.zeros(len(self), np.bool_)
        found[self.planned] = says_all(PROTOCOLS[protocol], self.outcomes(protocol))
        return found

    @property
    def driving(self) -> tuple[Floats, Bools] | None:
        """`benchmark.records.driving.sample_scores` of the rows that have driving scores, if any has."""
        if ("driving", "values") not in self.arrays:
            return None
        return self.arrays["driving", "values"], self.arrays["driving", "known"]

    @cached_property
    def planned_tokens(self) -> tuple[str, ...]:
        """Tokens of the samples with a plan."""
        return tuple(map(self.values("sample_token").__getitem__, self.planned.tolist()))

    @cached_property
    def planned_scenes(self) -> tuple[str, ...]:
        """Scenes of the samples with a plan."""
        return tuple(map(self.values("scene").__getitem__, self.planned.tolist()))

    @cached_property
    def failed(self) -> Bools:
        """(R,) whether a sample has no plan."""
        found = np.ones(len(self), np.bool_)
        found[self.planned] = False
        return found

    @cached_property
    def failed_tokens(self) -> frozenset[str]:
        """Tokens of the samples without a plan."""
        return frozenset(map(self.values("sample_token").__getitem__, np.flatnonzero(self.failed).tolist()))

    @cached_property
    def places_of_scenes(self) -> dict[str, NDArray[np.int64]]:
        """Places of each scene's rows, in the order in which scenes appear."""
        codes, scenes = self.arrays["scene", CODES], different_values(self.arrays, ("scene",))
        ends = np.cumsum(np.bincount(codes, minlength=len(scenes)))[:-1]
        return dict(zip(map(sys.intern, scenes), np.split(np.argsort(codes, kind="stable"), ends)))


class BriefRows(Sequence[BriefRow]):
    """What is light of each row of columns; rows are made when they are asked for.

    Args:
        columns: The columns.
    """

    def __init__(self, columns: RowColumns) -> None:
        self._columns = columns

    def __len__(self) -> int:
        return len(self._columns)

    def __iter__(self) -> Iterator[BriefRow]:
        return map(BriefRow, *self._values())

    @overload
    def __getitem__(self, place: int) -> BriefRow: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[BriefRow]: ...
    def __getitem__(self, place: int | slice) -> BriefRow | Sequence[BriefRow]:
        if isinstance(place, slice):
            return list(self)[place]
        return BriefRow(*(values[place] for values in self._values()))

    def at(self, places: Sequence[int]) -> list[BriefRow]:
        """Some of the rows."""
        return [BriefRow(*row) for row in zip(*(map(values.__getitem__, places) for values in self._values()))]

    def _values(self) -> list[Sequence[Any]]:
        return [self._columns.values(field.name) for field in fields(BriefRow)]


@lru_cache(maxsize=_REMEMBERED)
def _values(columns: RowColumns, field: str) -> Sequence[Any]:
    make = _MAKES.get(field)
    different = different_values(columns.arrays, (field,))
    if make is not None:
        different = [None if value is None else make(value) for value in different]
    return tuple(map(different.__getitem__, columns.arrays[field, CODES].tolist()))
