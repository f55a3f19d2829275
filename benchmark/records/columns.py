"""Columns of a record's rows for tables, as one Arrow batch: the same in memory and in a file of the user's cache.

A column has a value for each row, some value where the row has none. Verdicts, plans and scores are lists of numbers;
everything else is JSON, each different text once. What is made of columns for Python is remembered for a few planners.
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
from pydantic import TypeAdapter

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.machine.cached_arrays import to_arrow, to_numpy_array
from benchmark.protocols import PROTOCOLS, ProtocolOutcomes, counts_at_all_horizons
from benchmark.records.row_schema import BriefRow, DiagnosisRow, LongerPlanRow, PlanSeverityRow, SampleRow, Waypoints
from benchmark.untrusted.files import RECORD
from benchmark.untrusted.text_files import parse_json
from benchmark.waypoints import waypoints_in_lidar

LINES: Final = "lines"
"""The column of what `benchmark.records.rows.SampleRows` keeps beside columns."""
_CACHED_COLUMNS: Final = 64
"""Columns whose values are remembered: all of four planners."""
_ROWS_AT_ONCE: Final = 512
_VERDICTS: Final = ("outcomes", "steps", "facts")
"""How the names of their columns begin; those of a protocol and of a part follow."""
_TO_JSON: Final = TypeAdapter(Any).serializer.to_json
_SHARED_L2: Final = "outcomes/exact/l2"
_IN_LIDAR, _RECORDED, _MOVED = "waypoints_in_lidar", "recorded_in_lidar", "moved"
_SCORES, _SCORED = "driving/values", "driving/known"
_ENDED: Final = (np.nan, np.nan)
_BRIEF: Final = tuple(field.name for field in fields(BriefRow))
_TYPES: Final = {pa.dictionary(pa.int32(), pa.string()), pa.bool_(), pa.int64(), pa.float64(), pa.binary()}
_MAKES: Final[Mapping[str, Callable[[Any], Any]]] = {
    # They are equal for all planners of a split.
    "scene": sys.intern,
    "sample_token": sys.intern,
    "judged": frozenset,
    "diagnosis": DiagnosisRow.model_validate,
    "longer": LongerPlanRow.model_validate,
    "severity": PlanSeverityRow.model_validate,
}
"""Fields that are not as JSON has them."""


class RowColumns:
    """Columns of a record.

    ``rows``, one for each sample, are asked again only for verdicts that do not go together in columns. ``kept`` holds
    what others made of the columns, under a key that says all that it depends on.
    """

    def __init__(self, rows: Sequence[SampleRow], batch: pa.RecordBatch | None = None) -> None:
        self._rows = rows
        built = build_batch(rows) if batch is None else batch
        self.batch = _piece(list(rows)) if built is None else built
        self.kept: dict[Any, Any] = {}

    def __len__(self) -> int:
        return int(self.batch.num_rows)

    def values(self, field: str) -> Sequence[Any]:
        """(R,) values of a field of `BriefRow`, one for each row; the list must not be changed."""
        return _values(self, field)

    def flags(self, field: str) -> Bools:
        """(R,) the same of a field that is true or false."""
        different, codes = self._coded(field)
        return np.array(different, np.bool_)[codes]

    @property
    def brief(self) -> list[BriefRow]:
        """Light part of each row."""
        return list(map(BriefRow, *map(self.values, _BRIEF)))

    def brief_at(self, places: Sequence[int]) -> list[BriefRow]:
        """The same of some of the rows."""
        return [BriefRow(*row) for row in zip(*(map(self.values(field).__getitem__, places) for field in _BRIEF))]

    @cached_property
    def planned(self) -> NDArray[np.int64]:
        """(S,) places of the rows with a plan."""
        return to_numpy_array(to_arrow(np.flatnonzero(~self.failed)))

    @property
    def in_lidar(self) -> Floats:
        """(S, 6, 2) planned waypoints of the lidar origin of the rows in `planned`, metres."""
        return self._numbers(_IN_LIDAR, ~self.failed).reshape(-1, PLAN_STEPS, 2)

    @property
    def recorded(self) -> Floats:
        """(S, 6, 2) recorded positions of the lidar origin at the same steps, metres; NaN past the end."""
        return self._numbers(_RECORDED, ~self.failed).reshape(-1, PLAN_STEPS, 2)

    @property
    def moved(self) -> Floats:
        """(S, 3) x, y, yaw of the recorded lidar origin half a second later; NaN past the end."""
        return self._numbers(_MOVED, ~self.failed)

    def outcomes(self, protocol: str) -> ProtocolOutcomes:
        """Verdicts of a protocol, which judged all of them (else KeyError), on the rows in `planned`; read-only."""
        if _format_column_name("outcomes", protocol, "counted") not in self.batch.schema.names:
            return ProtocolOutcomes.from_rows(
                [vars(row.outcomes[protocol]) for row in self._rows if row.status == "ok"]
            )
        return _outcomes(self, protocol)

    def collides(self, protocol: str) -> Bools:
        """(R,) whether a row counts under a protocol and its plan collides; rows without a plan do not."""
        outcomes = self.outcomes(protocol)
        return self._of_planned(outcomes.decided & outcomes.collision.any(axis=1))

    def counted(self, protocol: str) -> Bools:
        """(R,) whether a row counts under a known protocol, at all three horizons, and its collisions are known."""
        return self._of_planned(counts_at_all_horizons(PROTOCOLS[protocol], self.outcomes(protocol)))

    def _of_planned(self, flags: Bools) -> Bools:
        row_flags = np.zeros(len(self), np.bool_)
        row_flags[self.planned] = flags
        return row_flags

    @property
    def driving(self) -> tuple[Floats, Bools] | None:
        """`benchmark.records.driving.read_sample_scores` of the rows that have driving scores, if any has."""
        if _SCORES not in self.batch.schema.names:
            return None
        driven = self.flags("driven")
        return self._numbers(_SCORES, driven), self._numbers(_SCORED, driven)

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
        is_failed: Bools = np.array(self.values("status")) == "failed"
        return is_failed

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

    def _numbers(self, name: str, rows: Bools) -> NDArray[Any]:
        column = self.batch.column(name)
        values = to_numpy_array(column.values).reshape(len(self), -1)
        values = values[:, 0] if column.type.list_size == 1 else values
        if not rows.all():
            values = values[rows]
            values.flags.writeable = False
        return values

    def _json(self, name: str, rows: Bools) -> tuple[Any, ...]:
        different, codes = self._coded(name)
        return tuple(map(different.__getitem__, codes[rows].tolist()))

    def _coded(self, name: str) -> tuple[list[Any], NDArray[np.int32]]:
        """Different values of JSON in the order in which they appear, and the number of each row's."""
        column = self.batch.column(name)
        texts = ",".join(column.dictionary.to_pylist())
        return parse_json(f"[{texts}]".encode(), RECORD), to_numpy_array(column.indices)


@lru_cache(maxsize=_CACHED_COLUMNS)
def _values(columns: RowColumns, name: str) -> tuple[Any, ...]:
    different, codes = columns._coded(name)
    make = _MAKES.get(name, lambda value: value)
    return tuple(map([None if value is None else make(value) for value in different].__getitem__, codes.tolist()))


@lru_cache(maxsize=_CACHED_COLUMNS)
def _outcomes(columns: RowColumns, protocol: str) -> ProtocolOutcomes:
    planned = ~columns.failed

    def those(kind: str, read: Callable[[str, Bools], Any]) -> dict[str, Any]:
        above = _format_column_name(kind, protocol)
        names = (name for name in columns.batch.schema.names if name.startswith(above))
        return {unquote(name.removeprefix(above)): read(name, planned) for name in names}

    arrays, steps, facts = map(those, _VERDICTS, (columns._numbers, columns._numbers, columns._json))
    arrays["l2"] = arrays["l2"] if "l2" in arrays else columns._numbers(_SHARED_L2, planned)
    known = arrays.pop("known")
    return ProtocolOutcomes(**arrays, steps=steps, facts=facts, known=None if known.all() else known)


def _format_column_name(kind: str, protocol: str, part: str = "") -> str:
    return f"{kind}/{quote(protocol, safe='')}/{quote(part, safe='')}"


def build_batch(rows: Iterable[SampleRow]) -> pa.RecordBatch | None:
    """Columns of R rows, of which few are in memory at a time; ``None`` where only all rows show what goes together.

    They are every field of `BriefRow`, as JSON, plans and recorded motion as in `RowColumns`, driving scores where a
    row has some, and of each protocol whose verdicts go together what `ProtocolOutcomes` has (`_format_column_name`).
    """
    waiting, pieces, unjudged = iter(rows), list[pa.Table](), 0
    while batch_rows := list(islice(waiting, _ROWS_AT_ONCE)):
        pieces.append(pa.Table.from_batches([_piece(batch_rows)]))
        unjudged += 0 if any(row.status == "ok" for row in batch_rows) else len(batch_rows)
    if not pieces:
        return _piece([])
    try:
        table = pa.concat_tables(pieces, promote_options="default")
    except (pa.ArrowInvalid, pa.ArrowTypeError):
        return None
    gaps = {table.column(name).null_count for name in table.column_names if name.startswith(_VERDICTS)}
    if not gaps <= {unjudged}:
        return None
    batch = table.combine_chunks().to_batches()[0]
    # Most protocols share the displacements of one, where they are stored once.
    l2 = {name: batch.column(name).buffers()[-1] for name in batch.schema.names if name.split("/")[2:] == ["l2"]}
    shared = l2.pop(_SHARED_L2, None)
    return batch.drop_columns([name for name, values in l2.items() if shared is not None and values == shared])


def _piece(rows: Sequence[SampleRow]) -> pa.RecordBatch:
    columns = _brief(rows)
    planned = [row for row in rows if row.status == "ok"]
    numbers = _motion(planned)
    for name in sorted({name for row in planned for name in row.outcomes}):
        if all(name in row.outcomes for row in planned):
            numbers |= _verdicts(name, planned)
    has_plan = np.array([row.status == "ok" for row in rows], np.bool_)
    columns |= {name: _scatter_column(values, has_plan) for name, values in numbers.items()}
    scored = np.array([row.driving is not None for row in rows], np.bool_)
    columns |= {name: _scatter_column(values, scored) for name, values in _scores(rows).items()}
    return pa.RecordBatch.from_arrays(list(columns.values()), names=list(columns))


def is_column_batch(batch: pa.RecordBatch) -> bool:
    """Whether a batch has what every record has, its lines too, and types of columns alone."""
    needed = _piece([]).append_column(LINES, concatenate_bytes(pa.binary(), [])).schema
    flat = {kind.value_type if pa.types.is_fixed_size_list(kind) else kind for kind in batch.schema.types}
    return flat <= _TYPES and set(needed) <= set(batch.schema)


def _brief(rows: Sequence[SampleRow]) -> dict[str, pa.Array]:
    stored = [name for name in _BRIEF if name in SampleRow.model_fields]
    return {name: _texts(getattr(row, name) for row in rows) for name in stored} | {
        "recorded": _texts(any(row.recorded_future) for row in rows),
        "judged": _texts(sorted(row.outcomes) for row in rows),
        "driven": _texts(row.driving is not None for row in rows),
    }


def _verdicts(protocol: str, planned: Sequence[SampleRow]) -> dict[str, Any]:
    """Verdicts of a protocol on rows with a plan; none where they do not go together."""
    try:
        outcomes = ProtocolOutcomes.from_rows([vars(row.outcomes[protocol]) for row in planned])
    except (KeyError, ValueError):
        # Readers of these verdicts raise the error.
        return {}
    if any(values.shape != outcomes.l2.shape or values.dtype.kind not in "bif" for values in outcomes.steps.values()):
        return {}
    arrays = {name: getattr(outcomes, name) for name in ("collision", "l2", "valid", "counted")}
    arrays["known"] = np.ones(len(outcomes), np.bool_) if outcomes.known is None else outcomes.known
    kinds = zip(_VERDICTS, (arrays, outcomes.steps, outcomes.facts))
    return {
        _format_column_name(kind, protocol, part): values for kind, parts in kinds for part, values in parts.items()
    }


def _motion(rows: Sequence[SampleRow]) -> dict[str, Any]:
    """Plans and recorded motion of rows with a plan; NaN where there is none."""
    moved, in_lidar = np.full((len(rows), 3), np.nan), np.full((len(rows), PLAN_STEPS, 2), np.nan)
    recorded, of_frames = in_lidar.copy(), dict[str, list[tuple[int, float, Waypoints]]]()
    for place, row in enumerate(rows):
        waypoints, future = row.plan.waypoints[:PLAN_STEPS] if row.plan is not None else [], row.recorded_future
        # Malformed plans are reported where they are judged.
        if row.plan is not None and len(waypoints) == PLAN_STEPS and all(len(point) == 2 for point in waypoints):
            of_frames.setdefault(row.plan.frame, []).append((place, row.lidar_ahead_m, waypoints))
        if future and future[0]:
            moved[place] = future[0]
        if len(future) == PLAN_STEPS:
            recorded[place] = [pose[:2] if pose is not None and len(pose) > 1 else _ENDED for pose in future]
    for frame, plans in of_frames.items():
        places, ahead, stacked = map(np.array, zip(*plans))
        in_lidar[places] = waypoints_in_lidar(stacked, frame, ahead)
    return {_IN_LIDAR: in_lidar, _RECORDED: recorded, _MOVED: moved}


def _scores(rows: Sequence[SampleRow]) -> dict[str, NDArray[Any]]:
    from benchmark.records.driving import read_sample_scores

    driven = [row.driving for row in rows if row.driving is not None]
    return dict(zip((_SCORES, _SCORED), read_sample_scores(driven))) if driven else {}


def _scatter_column(values: NDArray[Any] | tuple[Any, ...], there: Bools) -> pa.Array:
    if isinstance(values, tuple):
        waiting = iter(values)
        return _texts(next(waiting) if is_there else None for is_there in there.tolist())
    filled = np.zeros((len(there), math.prod(values.shape[1:])), values.dtype)
    filled[there] = values.reshape(-1, filled.shape[1])
    return pa.FixedSizeListArray.from_arrays(to_arrow(filled), filled.shape[1])


def _texts(values: Iterable[Any]) -> pa.DictionaryArray:
    return concatenate_bytes(pa.string(), list(map(_TO_JSON, values))).dictionary_encode()


def concatenate_bytes(kind: pa.DataType, pieces: Sequence[bytes | memoryview]) -> pa.Array:
    """Bytes, or text as bytes, as a column."""
    ends = np.cumsum([0, *map(len, pieces)], dtype=np.int32)
    return pa.Array.from_buffers(kind, len(pieces), [None, pa.py_buffer(ends), pa.py_buffer(b"".join(pieces))])
