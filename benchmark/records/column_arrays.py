"""Columns of a record as arrays under names, the same in memory and in a file of the user's cache.

Verdicts, plans and scores are arrays of numbers. Of everything else the different values are kept once, as JSON, beside
the number of each row's value.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.machine.storage import canonical_json, parse_json
from benchmark.protocols import Outcomes
from benchmark.records.row_schema import SampleRow
from benchmark.untrusted.limits import RECORD
from benchmark.waypoints import waypoints_in_lidar

Name = tuple[str, ...]
Arrays = Mapping[Name, NDArray[Any]]
OUTCOMES: Final = "outcomes"
CODES, TEXTS = "codes", "texts"
"""Of each row the number of its value; the different values, as JSON."""
STEPS, FACTS = "steps", "facts"
KNOWN: Final = "known"
"""Of a protocol's verdicts, only where some are unknown."""
_NUMBERS: Final = "bifu"
"""Kinds of arrays that are kept as they are."""
_PLAIN: Final = frozenset({str, int, bool, type(None)})


def arrays_of(rows: Sequence[SampleRow]) -> dict[Name, NDArray[Any]]:
    """Columns of R rows, S of which have a plan.

    Args:
        rows: One for each sample.

    Returns:
        ``planned``: places of the S rows; ``in_lidar`` (S, 6, 2), ``recorded`` (S, 6, 2) and ``moved`` (S, 3) as in
        `benchmark.records.columns.RowColumns`; ``driving`` ``values`` and ``known``, where a row has scores; of each
        protocol whose verdicts go together its `Outcomes`; every field of `benchmark.records.columns.BriefRow`, coded.
    """
    planned = [row for row in rows if row.status == "ok"]
    found: dict[Name, NDArray[Any]] = {
        ("planned",): np.array([place for place, row in enumerate(rows) if row.status == "ok"], np.int64)
    }
    found[("in_lidar",)], found[("moved",)] = _plans(planned)
    found[("recorded",)] = _recorded(planned)
    found |= _driving(rows)
    for name in sorted({name for row in planned for name in row.outcomes}):
        if all(name in row.outcomes for row in planned):
            found |= _outcomes(name, planned)
    for field, values in _brief(rows).items():
        found |= coded((field,), values)
    return _sharing(found)


def coded(name: Name, values: Sequence[Any]) -> dict[Name, NDArray[Any]]:
    """Values of JSON as arrays.

    Args:
        name: What they are called.
        values: R values.

    Returns:
        ``codes``, (R,), numbers of values in the order in which they first appear, and ``texts``, their JSON.
    """
    places: dict[Any, int] = {}
    different: list[Any] = []
    codes = np.empty(len(values), np.int32)
    for row, value in enumerate(values):
        kind = type(value)
        # Numbers that are equal are not always the same value.
        key = (kind, value if kind in _PLAIN else value.hex() if kind is float else canonical_json(value))
        code = places.get(key)
        if code is None:
            code = places[key] = len(different)
            different.append(value)
        codes[row] = code
    texts = np.frombuffer(json.dumps(different, separators=(",", ":")).encode(), np.uint8)
    return {(*name, CODES): codes, (*name, TEXTS): texts}


def different_values(arrays: Arrays, name: Name) -> list[Any]:
    """The different values of what is `coded`, in the order of their numbers."""
    found: list[Any] = parse_json(arrays[(*name, TEXTS)].tobytes(), RECORD)
    return found


class Facts(Mapping[str, tuple[Any, ...]]):
    """`Outcomes.facts` that are read when they are asked for.

    Args:
        arrays: All columns.
        protocol: Whose facts.
    """

    def __init__(self, arrays: Arrays, protocol: str) -> None:
        self._arrays = arrays
        self._above = (OUTCOMES, protocol, FACTS)
        self._names = [name[3] for name in arrays if name[:3] == self._above and name[4] == CODES]

    def __getitem__(self, name: str) -> tuple[Any, ...]:
        if name not in self._names:
            raise KeyError(name)
        values = different_values(self._arrays, (*self._above, name))
        return tuple(values[code] for code in self._arrays[(*self._above, name, CODES)].tolist())

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def outcomes_in(arrays: Arrays, protocol: str) -> Outcomes | None:
    """Verdicts of a protocol; ``None`` where they are not in columns."""
    above: Name = (OUTCOMES, protocol)
    if (*above, "collision") not in arrays:
        return None
    return Outcomes(
        collision=arrays[(*above, "collision")],
        l2=arrays[(*above, "l2")],
        valid=arrays[(*above, "valid")],
        counted=arrays[(*above, "counted")],
        steps={name[3]: values for name, values in arrays.items() if name[:3] == (*above, STEPS)},
        facts=Facts(arrays, protocol),
        known=arrays.get((*above, KNOWN)),
    )


def _outcomes(protocol: str, planned: Sequence[SampleRow]) -> dict[Name, NDArray[Any]]:
    """Verdicts of a protocol on rows with a plan; none where they do not go together."""
    try:
        found = Outcomes.from_rows([vars(row.outcomes[protocol]) for row in planned])
    except (KeyError, ValueError):
        # Whoever asks for them gets the error that they deserve.
        return {}
    above: Name = (OUTCOMES, protocol)
    arrays = {(*above, name): getattr(found, name) for name in ("collision", "l2", "valid", "counted")}
    arrays |= {(*above, STEPS, name): values for name, values in found.steps.items()}
    if found.known is not None:
        arrays[(*above, KNOWN)] = found.known
    if any(values.dtype.kind not in _NUMBERS for values in arrays.values()):
        return {}
    for name, values in found.facts.items():
        arrays |= coded((*above, FACTS, name), values)
    return arrays


def _plans(rows: Sequence[SampleRow]) -> tuple[Floats, Floats]:
    """Waypoints in the lidar frame and the first step of the recording, of rows with a plan."""
    in_lidar, moved = np.full((len(rows), PLAN_STEPS, 2), np.nan), np.full((len(rows), 3), np.nan)
    plans = [(place, row.lidar_ahead_m, row.plan) for place, row in enumerate(rows) if row.plan is not None]
    for frame, ahead in sorted({(plan.frame, ahead) for _, ahead, plan in plans}):
        those = [
            (place, plan.waypoints[:PLAN_STEPS]) for place, own, plan in plans if (plan.frame, own) == (frame, ahead)
        ]
        # Plans that are no plans are found by whoever judges them.
        those = [each for each in those if len(each[1]) == PLAN_STEPS and all(len(point) == 2 for point in each[1])]
        if those:
            places, waypoints = zip(*those)
            in_lidar[list(places)] = waypoints_in_lidar(np.array(waypoints, np.float64), frame, ahead)
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


def _driving(rows: Sequence[SampleRow]) -> dict[Name, NDArray[Any]]:
    from benchmark.records.driving import sample_scores

    driven = [row.driving for row in rows if row.driving is not None]
    if not driven:
        return {}
    values, known = sample_scores(driven)
    return {("driving", "values"): values, ("driving", "known"): known}


def _brief(rows: Sequence[SampleRow]) -> dict[str, list[Any]]:
    """Fields of `benchmark.records.columns.BriefRow` as JSON values."""
    plain = ("scene", "sample_token", "index", "timestamp_us", "status", "command", "complete", "place", "speed_m_s")
    models = ("diagnosis", "longer", "severity")
    return {
        **{name: [getattr(row, name) for row in rows] for name in plain},
        **{
            name: [None if (part := getattr(row, name)) is None else part.model_dump(mode="json") for row in rows]
            for name in models
        },
        "recorded": [any(row.recorded_future) for row in rows],
        "judged": [sorted(row.outcomes) for row in rows],
        "disagreements": [row.disagreements for row in rows],
        "driven": [row.driving is not None for row in rows],
    }


def _sharing(arrays: dict[Name, NDArray[Any]]) -> dict[Name, NDArray[Any]]:
    """The same arrays, which nobody may write to; those that are equal, displacements above all, are one."""
    seen: dict[tuple[Any, ...], NDArray[Any]] = {}

    def one(values: NDArray[Any]) -> NDArray[Any]:
        values.flags.writeable = False
        return seen.setdefault((values.shape, values.dtype.str, values.tobytes()), values)

    return {name: one(values) for name, values in arrays.items()}
