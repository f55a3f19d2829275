"""What tables read of a record's rows, as one Arrow batch: the same in memory and in a file of the user's cache.

A column has a value for each row, null where the row has none. Verdicts, plans and scores are numbers; everything else
is JSON, each different text once. What is made of columns for Python is remembered for a few planners at a time.
"""

import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from functools import cached_property, lru_cache
from itertools import islice
from typing import Any, Final
from urllib.parse import quote, unquote

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic_core import to_json

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, Outcomes, says_all
from benchmark.records.row_schema import BriefRow, DiagnosisRow, LongerRow, PlanSeverityRow, SampleRow
from benchmark.untrusted.json_text import parse_json
from benchmark.untrusted.limits import RECORD
from benchmark.waypoints import waypoints_in_lidar

LINES: Final = "lines"
"""The column of what `benchmark.records.rows.Rows` keeps beside columns."""
_REMEMBERED: Final = 64
"""Columns whose values are remembered: all of four planners."""
_ROWS_AT_ONCE: Final = 512
_OUTCOMES, _L2, _SHARES_L2 = "outcomes/", "l2", "exact"
_STEPS, _FACTS = "steps/", "facts/"
_IN_LIDAR, _RECORDED, _MOVED = "waypoints_in_lidar", "recorded_in_lidar", "moved"
_SCORES, _SCORED = "driving/values", "driving/known"
_TYPES: Final = {pa.dictionary(pa.int32(), pa.string()), pa.bool_(), pa.int64(), pa.float64(), pa.binary()}
_BRIEF: Final = tuple(field.name for field in fields(BriefRow))
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
        batch: Their columns, where they are at hand.

    Attributes:
        batch: The columns, as `batch_of` makes them.
        failures: Kept by `benchmark.records.run.scene_failures`, by protocol.
        kept: What others made of the columns, under a key of theirs that says all that it depends on.
    """

    def __init__(self, rows: Sequence[SampleRow], batch: pa.RecordBatch | None = None) -> None:
        self._rows = rows
        found = batch_of(rows) if batch is None else batch
        self.batch = _piece(list(rows)) if found is None else found
        self.failures: dict[str, dict[str, bool | None]] = {}
        self.kept: dict[Any, Any] = {}

    def __len__(self) -> int:
        return int(self.batch.num_rows)

    def values(self, field: str) -> Sequence[Any]:
        """(R,) values of a field of `BriefRow`, one for each row; nobody may change the list."""
        return _values(self, field)

    def flags(self, field: str) -> Bools:
        """(R,) the same of a field that is true or false."""
        different, codes = self._coded(field)
        return np.array(different, np.bool_)[codes]

    @property
    def brief(self) -> list[BriefRow]:
        """What is light of each row."""
        return list(map(BriefRow, *map(self.values, _BRIEF)))

    def brief_at(self, places: Sequence[int]) -> list[BriefRow]:
        """The same of some of the rows."""
        return [BriefRow(*row) for row in zip(*(map(self.values(field).__getitem__, places) for field in _BRIEF))]

    @cached_property
    def planned(self) -> NDArray[np.int64]:
        """(S,) places of the rows with a plan."""
        return _as_numpy(pa.array(np.flatnonzero(~self.failed)))

    @property
    def in_lidar(self) -> Floats:
        """(S, 6, 2) planned waypoints of the lidar origin of the rows in `planned`, metres."""
        return self._numbers(_IN_LIDAR).reshape(-1, PLAN_STEPS, 2)

    @property
    def recorded(self) -> Floats:
        """(S, 6, 2) recorded positions of the lidar origin at the same steps, metres; NaN past the end."""
        return self._numbers(_RECORDED).reshape(-1, PLAN_STEPS, 2)

    @property
    def moved(self) -> Floats:
        """(S, 3) x, y, yaw of the recorded lidar origin half a second later; NaN past the end."""
        return self._numbers(_MOVED)

    def outcomes(self, protocol: str) -> Outcomes:
        """Verdicts of a protocol on the samples that have a plan, in their order; nobody may write to the arrays.

        Args:
            protocol: Its name.

        Returns:
            The verdicts.

        Raises:
            KeyError: If it did not judge a sample.
        """
        if f"{_OUTCOMES}{quote(protocol, safe='')}/counted" not in self.batch.schema.names:
            return Outcomes.from_rows([vars(row.outcomes[protocol]) for row in self._rows if row.status == "ok"])
        return _outcomes(self, protocol)

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
        if _SCORES not in self.batch.schema.names:
            return None
        return self._numbers(_SCORES), self._numbers(_SCORED)

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
        return _as_numpy(self.batch.column(_IN_LIDAR).is_null())

    @cached_property
    def failed_tokens(self) -> frozenset[str]:
        """Tokens of the samples without a plan."""
        return frozenset(map(self.values("sample_token").__getitem__, np.flatnonzero(self.failed).tolist()))

    @cached_property
    def places_of_scenes(self) -> dict[str, NDArray[np.int64]]:
        """Places of each scene's rows, in the order in which scenes appear."""
        scenes, codes = self._coded("scene")
        ends = np.cumsum(np.bincount(codes, minlength=len(scenes)))[:-1]
        return dict(zip(map(sys.intern, scenes), np.split(np.argsort(codes, kind="stable"), ends)))

    def _numbers(self, name: str) -> NDArray[Any]:
        """Of the rows that have some."""
        column = self.batch.column(name).drop_null()
        if not pa.types.is_fixed_size_list(column.type):
            return _as_numpy(column)
        return _as_numpy(column.flatten()).reshape(-1, column.type.list_size)

    def _coded(self, name: str) -> tuple[list[Any], NDArray[np.int32]]:
        """Different values of JSON in the order in which they appear, and the number of each row's, if it has one."""
        column = self.batch.column(name).drop_null()
        return parse_json(f"[{','.join(column.dictionary.to_pylist())}]".encode(), RECORD), _as_numpy(column.indices)


@lru_cache(maxsize=_REMEMBERED)
def _values(columns: RowColumns, name: str) -> tuple[Any, ...]:
    make = _MAKES.get(name)
    different, codes = columns._coded(name)
    if make is not None:
        different = [None if value is None else make(value) for value in different]
    return tuple(map(different.__getitem__, codes.tolist()))


@lru_cache(maxsize=_REMEMBERED)
def _outcomes(columns: RowColumns, protocol: str) -> Outcomes:
    above, names = f"{_OUTCOMES}{quote(protocol, safe='')}/", columns.batch.schema.names
    own = {name.removeprefix(above): name for name in names if name.startswith(above)}
    own.setdefault(_L2, f"{_OUTCOMES}{_SHARES_L2}/{_L2}")
    facts = {unquote(part.removeprefix(_FACTS)): own.pop(part) for part in [*own] if part.startswith(_FACTS)}
    numbers = {part: columns._numbers(name) for part, name in own.items()}
    steps = {unquote(part.removeprefix(_STEPS)): numbers.pop(part) for part in own if part.startswith(_STEPS)}
    known = numbers.pop("known")
    values = {fact: _values.__wrapped__(columns, name) for fact, name in facts.items()}
    return Outcomes(**numbers, steps=steps, facts=values, known=None if known.all() else known)


def batch_of(rows: Iterable[SampleRow]) -> pa.RecordBatch | None:
    """Columns of R rows, of which few are in memory at a time.

    Args:
        rows: One for each sample.

    Returns:
        Every field of `BriefRow`, as JSON; plans and recorded motion as in `RowColumns`; driving scores, where a row
        has some; of each protocol whose verdicts go together what `Outcomes` has, below ``outcomes/PROTOCOL/``. ``None``
        where only all rows together show what goes together.
    """
    waiting, pieces = iter(rows), list[pa.RecordBatch]()
    while some := list(islice(waiting, _ROWS_AT_ONCE)):
        pieces.append(_piece(some))
    if not pieces:
        return _piece([])
    try:
        table = pa.concat_tables([pa.Table.from_batches([piece]) for piece in pieces], promote_options="default")
    except (pa.ArrowInvalid, pa.ArrowTypeError):
        return None
    gaps = {table.column(name).null_count for name in table.column_names if name.startswith(_OUTCOMES)}
    if not gaps <= {table.column(_IN_LIDAR).null_count}:
        return None
    batch = table.combine_chunks().to_batches()[0]
    # Displacements of most protocols are those of one, where they stand once.
    l2 = {
        name: batch.column(name).buffers()[-1]
        for name in batch.schema.names
        if name.count("/") == 2 and name.endswith(_L2)
    }
    shared = f"{_OUTCOMES}{_SHARES_L2}/{_L2}"
    same = {name for name, values in l2.items() if name != shared and shared in l2 and values == l2[shared]}
    return batch.select([name for name in batch.schema.names if name not in same])


def _piece(rows: Sequence[SampleRow]) -> pa.RecordBatch:
    planned = [row for row in rows if row.status == "ok"]
    in_lidar, moved = _plans(planned)
    numbers = {_IN_LIDAR: in_lidar, _RECORDED: _recorded(planned), _MOVED: moved}
    of_planned = {name: _stacked(values) for name, values in numbers.items()}
    for name in sorted({name for row in planned for name in row.outcomes}):
        if all(name in row.outcomes for row in planned):
            of_planned |= _verdicts(name, planned)
    columns = {
        **_brief(rows),
        **_placed(of_planned, [row.status == "ok" for row in rows]),
        **_placed(_scores(rows), [row.driving is not None for row in rows]),
    }
    return pa.RecordBatch.from_arrays(list(columns.values()), names=list(columns))


def is_made_of_columns(batch: pa.RecordBatch) -> bool:
    """Whether a batch has types of columns alone, and the columns that every record has, with its lines."""
    flat = {kind.value_type if pa.types.is_fixed_size_list(kind) else kind for kind in batch.schema.types}
    return flat <= _TYPES and {*_BRIEF, _IN_LIDAR, _RECORDED, _MOVED, LINES} <= set(batch.schema.names)


def _brief(rows: Sequence[SampleRow]) -> dict[str, pa.Array]:
    stored = [name for name in _BRIEF if name in SampleRow.model_fields]
    found = {name: _texts(getattr(row, name) for row in rows) for name in stored}
    found["recorded"] = _texts(any(row.recorded_future) for row in rows)
    found["judged"] = _texts(sorted(row.outcomes) for row in rows)
    found["driven"] = _texts(row.driving is not None for row in rows)
    return found


def _verdicts(protocol: str, planned: Sequence[SampleRow]) -> dict[str, pa.Array]:
    """Verdicts of a protocol on rows with a plan; none where they do not go together."""
    try:
        found = Outcomes.from_rows([vars(row.outcomes[protocol]) for row in planned])
    except (KeyError, ValueError):
        # Whoever asks for them gets the error that they deserve.
        return {}
    steps = {f"{_STEPS}{quote(name, safe='')}": values for name, values in found.steps.items()}
    if any(values.shape != found.l2.shape or values.dtype.kind not in "bif" for values in steps.values()):
        return {}
    numbers = {name: getattr(found, name) for name in ("collision", _L2, "valid", "counted")} | steps
    numbers["known"] = np.ones(len(found), np.bool_) if found.known is None else found.known
    columns = {part: _stacked(values) for part, values in numbers.items()}
    columns |= {f"{_FACTS}{quote(name, safe='')}": _texts(values) for name, values in found.facts.items()}
    return {f"{_OUTCOMES}{quote(protocol, safe='')}/{part}": column for part, column in columns.items()}


def _plans(rows: Sequence[SampleRow]) -> tuple[Floats, Floats]:
    """Waypoints in the lidar frame and the first step of the recording, of rows with a plan."""
    in_lidar, moved = np.full((len(rows), PLAN_STEPS, 2), np.nan), np.full((len(rows), 3), np.nan)
    for frame in ("lidar", "ego"):
        # Plans that are no plans are found by whoever judges them.
        those = [
            (place, row.lidar_ahead_m, row.plan.waypoints[:PLAN_STEPS])
            for place, row in enumerate(rows)
            if row.plan is not None
            and row.plan.frame == frame
            and len(row.plan.waypoints) >= PLAN_STEPS
            and all(len(point) == 2 for point in row.plan.waypoints[:PLAN_STEPS])
        ]
        if those:
            places, ahead, waypoints = map(np.array, zip(*those))
            in_lidar[places] = waypoints_in_lidar(waypoints, frame, ahead)
    for place, row in enumerate(rows):
        if row.recorded_future and (pose := row.recorded_future[0]):
            moved[place] = pose
    return in_lidar, moved


def _recorded(rows: Sequence[SampleRow]) -> Floats:
    """Recorded positions of the lidar at the steps of plans; NaN past the end."""
    ended = [np.nan, np.nan]
    futures = [row.recorded_future if len(row.recorded_future) == PLAN_STEPS else [None] * PLAN_STEPS for row in rows]
    points = [pose[:2] if pose is not None and len(pose) > 1 else ended for future in futures for pose in future]
    return np.array(points, np.float64).reshape(-1, PLAN_STEPS, 2)


def _scores(rows: Sequence[SampleRow]) -> dict[str, pa.Array]:
    from benchmark.records.driving import sample_scores

    driven = [row.driving for row in rows if row.driving is not None]
    return dict(zip((_SCORES, _SCORED), map(_stacked, sample_scores(driven)))) if driven else {}


def _texts(values: Iterable[Any]) -> pa.DictionaryArray:
    """Values of JSON as a column."""
    return pa.array([to_json(value, by_alias=False) for value in values], pa.string()).dictionary_encode()


def _stacked(values: NDArray[Any]) -> pa.Array:
    """(S, ...) numbers as a column of S rows."""
    flat = pa.array(values.reshape(-1))
    return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, math.prod(values.shape[1:]))


def _placed(columns: Mapping[str, pa.Array], there: Sequence[bool]) -> dict[str, pa.Array]:
    """Columns of the rows that are there as columns of all rows."""
    places = pa.array(np.cumsum(there) - 1, mask=~np.array(there, np.bool_))
    return {name: column if all(there) else column.take(places) for name, column in columns.items()}


def _as_numpy(column: pa.Array) -> NDArray[Any]:
    """The values of a column without gaps; nobody may write to them."""
    values: NDArray[Any] = column.to_numpy(zero_copy_only=False)
    values.flags.writeable = False
    return values
