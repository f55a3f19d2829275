"""``--plans FILE``: plans that a model made elsewhere, one row a sample.

CSV, Parquet or JSON with these columns:

* ``sample_token``, or both ``scene`` and ``timestamp`` (microseconds, the sample's keyframe time); the token of a
  keyframe row of ``sample_data.json`` stands for its sample
* ``frame``: ``lidar`` (x right, y forward, positions of the lidar origin) or ``ego`` (x forward, y left, positions of
  the rear axle)
* ``x1``, ``y1``, ... ``x6``, ``y6``: waypoints at 0.5, 1.0, ... 3.0 s, metres

JSON is a list of objects with these keys. Columns that are not named here are an error, so that a misspelt one is
noticed. Every sample of the split needs exactly one row; with ``--allow-partial`` a sample without one has failed.
A CSV may have what Excel writes where the comma is the decimal sign: ``;`` between columns, and a mark of UTF-8.
"""

import json
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from adapters.models import published_as
from benchmark.constants import FARTHEST_WAYPOINT_M, LONGEST_PLAN_STEPS, PLAN_STEPS
from benchmark.datasets.contents import list_scenes_by_split
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings
from benchmark.geometry import Floats
from benchmark.machine.storage import file_sha256
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.records.caveats import Caveat
from benchmark.records.planner_versions import PLANS_SHA256
from benchmark.records.run_schema import PlannerFacts
from benchmark.records.store import find_record_with_samples
from benchmark.runs.code_identity import code_sha256
from benchmark.runs.planner_facts import require_known_native
from benchmark.truth import SampleTruth
from benchmark.untrusted.files import to_one_line
from benchmark.untrusted.plan_plausibility import ComparedPlans, FrameName, measure_plausibility
from benchmark.untrusted.plan_verdicts import describe_checks, format_refusal, make_as_is_caveat
from benchmark.untrusted.tables import read_table
from benchmark.waypoints import waypoints_in_lidar

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

LONGEST_COLUMNS = tuple(f"{axis}{step}" for step in range(1, LONGEST_PLAN_STEPS + 1) for axis in "xy")
WAYPOINT_COLUMNS = LONGEST_COLUMNS[: 2 * PLAN_STEPS]
"""Those that every plan file has; the others may follow, one step after the other."""
_BY_TOKEN, _BY_TIME = ("sample_token",), ("scene", "timestamp")
_MOST_LISTED = 3


@dataclass(frozen=True, slots=True)
class RecordedFuture:
    """Recorded (6, 2) lidar positions, x right, y forward, metres, NaN past the end; the lidar is ahead of the axle."""

    lidar_ahead_m: float
    positions: Floats

    @classmethod
    def of(cls, truth: SampleTruth) -> "RecordedFuture":
        """After a sample."""
        positions = np.where(truth.ego_future_valid[:, None], truth.ego_future[:, :2], np.nan)
        return cls(truth.lidar_ahead_m, positions)


SplitSamples = Mapping[str, Mapping[tuple[Hashable, ...], RecordedFuture]]
"""Samples by scene and by what rows call them."""


@dataclass(frozen=True, slots=True)
class PlanFile:
    """A read plan file of R rows: ``(token,)`` or ``(scene, timestamp)`` keys, and (R, N, 2) metres, 6 to 16 steps."""

    path: Path
    by_token: bool
    keys: tuple[tuple[Hashable, ...], ...]
    frames: tuple[PlanFrame, ...]
    waypoints: Floats

    def require(
        self,
        samples: "SplitSamples",
        split: str,
        scenes: Sequence[str],
        *,
        allow_partial: bool = False,
    ) -> None:
        """Check that there is one row for every sample of the split, and none for anything else.

        `scenes` are those that will be evaluated; rows of the split's other scenes may stay. With `allow_partial` a
        sample without a row has failed; one row at least is needed.
        """
        present = set(self.keys)
        missing = [key for scene in scenes for key in sorted(samples[scene].keys() - present, key=str)]
        if missing and not (allow_partial and len(missing) < sum(len(samples[scene]) for scene in scenes)):
            rule = "no sample has one" if allow_partial else "every sample needs a plan, or give --allow-partial"
            raise InputError(f"{self.path} has no row for {_format_keys(missing)} of split {split!r}; {rule}")
        known = set().union(*samples.values())
        extra = [key for key in self.keys if key not in known]
        if extra:
            raise InputError(
                f"{self.path} has rows for {_format_keys(extra)} for samples outside split {split!r}; remove them"
            )

    def samples_of(self, data: "DataSet", split: str) -> "SplitSamples":
        """Samples of a split by scene and by what rows call them, with what was recorded."""
        return {
            name: {self._key(truth): RecordedFuture.of(truth) for truth in data.truth(name)}
            for name in data.scene_names(split)
        }

    def by_samples(self, tokens: Mapping[str, str]) -> "PlanFile":
        """Rename rows to samples by `tokens`; two rows of one sample are an `InputError`."""
        keys = tuple((tokens.get(str(key[0]), key[0]),) for key in self.keys)
        _require_unique(self.path, keys)
        return replace(self, keys=keys)

    def compared(self, samples: "SplitSamples") -> ComparedPlans:
        """Plans of samples beside what was recorded."""
        known = {key: future for of_scene in samples.values() for key, future in of_scene.items()}
        rows = [row for row, key in enumerate(self.keys) if key in known]
        futures = [known[self.keys[row]] for row in rows]
        plans = [
            waypoints_in_lidar(self.waypoints[row, :PLAN_STEPS], self.frames[row], future.lidar_ahead_m)
            for row, future in zip(rows, futures, strict=True)
        ]
        shape = (len(rows), PLAN_STEPS, 2)
        recorded = np.array([future.positions for future in futures]).reshape(shape)
        return ComparedPlans.of(np.array(plans).reshape(shape), recorded)

    def _key(self, sample: SampleTruth | Observation) -> tuple[Hashable, ...]:
        return (sample.sample_token,) if self.by_token else (sample.scene, sample.timestamp_us)


class PlanFilePlanner:
    """Planner that gives the plans of a file, after which it is named unless a name is given."""

    def __init__(self, plans: PlanFile, name: str | None = None) -> None:
        self.name = name or plans.path.stem
        self._plans = plans
        self._row_of = {key: row for row, key in enumerate(plans.keys)}

    def reset(self, scene: SceneInfo) -> None:
        """Do nothing."""

    def plan(self, observation: Observation) -> Plan:
        """The plan of the sample; an `InputError` if the file has no row for it."""
        row = self._row_of.get(self._plans._key(observation))
        if row is None:
            raise InputError(f"{self._plans.path} has no row for sample {observation.sample_token}")
        return Plan(self._plans.waypoints[row], self._plans.frames[row])


@dataclass(frozen=True, slots=True)
class PlanFileFactory:
    """Builds the planner of a plan file in any process.

    `tokens` are sample tokens by those of keyframe rows, where the file has these. `measured` holds results of the
    tests of unit, frame, origin and time, or a note that they are not testable.
    """

    path: Path
    facts: PlannerFacts
    tokens: Mapping[str, str] = field(default_factory=dict)
    frame: FrameName | None = None
    caveats: tuple[Caveat, ...] = ()
    measured: Mapping[str, str] = field(default_factory=dict)

    def __call__(self) -> PlanFilePlanner:
        """Read the file again."""
        plans = read_plan_file(self.path, self.frame)
        return PlanFilePlanner(plans.by_samples(self.tokens) if self.tokens else plans, self.facts.name)

    @property
    def sentences(self) -> list[str]:
        """Sentences about the file."""
        rows = "sample_token holds tokens of sample_data rows; each is mapped to the sample of its keyframe"
        notes = [f"{self.path}: {rows}"] if self.tokens else []
        return [*notes, f"{self.path}: {describe_checks(self.measured)}"]


def plan_file_factory(
    path: Path,
    data: "DataSet",
    split: str,
    *,
    scenes: tuple[str, ...] | None = None,
    limit: int | None = None,
    name: str | None = None,
    native: str | None = None,
    records: "Sequence[Path]" = (),
    allow_partial: bool = False,
    frame: FrameName | None = None,
    as_is: bool = False,
) -> PlanFileFactory:
    """The planner of a plan file, checked against the samples it is for.

    Args:
        path: CSV, Parquet or JSON file.
        data: The data set.
        split: The split.
        scenes: Only these scenes will be evaluated; the whole split by default.
        limit: Only the first so many of them.
        name: Shown in tables; the file's name without its ending by default.
        native: Protocol of the repository that the planner comes from, if it is known here.
        records: Folders of run records, to say what a file of other data is for.
        allow_partial: Whether samples may have no row; they have failed then.
        frame: Frame of all plans, ``lidar`` or ``ego``; overrides the file.
        as_is: Take plans unchanged, even if another unit, frame, origin or time fits better; the record notes it.

    Raises:
        InputError: If the file is malformed, its rows do not match the samples, its plans fit far better otherwise
            (`benchmark.untrusted`), or the native protocol is unknown.
    """
    require_known_native(native, f"plan file {path}")
    plans = read_plan_file(path, frame)
    chosen, samples = EvalSettings(scenes=scenes, limit=limit).chosen(data, split), plans.samples_of(data, split)
    tokens = _tokens_of_keyframes(plans, data, samples)
    plans = plans.by_samples(tokens) if tokens else plans
    try:
        plans.require(samples, split, chosen, allow_partial=allow_partial)
    except InputError as error:
        raise _other_split_error(plans, data, split, samples, records) or error from None
    plausibility = measure_plausibility(plans.compared(samples))
    if plausibility.misreading is not None and not as_is:
        raise InputError(format_refusal(path, plausibility.misreading))
    facts = PlannerFacts(
        name=name or path.stem,
        privileged=False,
        weights_sha256=None,
        code_sha256=code_sha256(PlanFilePlanner),
        settings={PLANS_SHA256: file_sha256(path), **({} if frame is None else {"frame": frame})},
        native_protocol=native,
        published_as=published_as(name or path.stem),
    )
    caveats = () if plausibility.misreading is None else (make_as_is_caveat(plausibility.misreading),)
    return PlanFileFactory(path, facts, tokens, frame, caveats, plausibility.measured)


def _tokens_of_keyframes(plans: PlanFile, data: "DataSet", samples: "SplitSamples") -> dict[str, str]:
    """Sample tokens by those of the file's keyframe rows; empty where it has none."""
    named = {str(key[0]) for key in plans.keys} if plans.by_token else set()
    if named <= {str(key[0]) for keys in samples.values() for key in keys}:
        return {}
    rows = {row: sample for scene in samples for row, sample in data.keyframe_rows(scene).items()}
    return {row: rows[row] for row in sorted(named & rows.keys())}


class OtherSamplesError(InputError):
    """A plan file has no row of a split."""


def _other_split_error(
    plans: PlanFile,
    data: "DataSet",
    split: str,
    samples: "SplitSamples",
    records: Sequence[Path],
) -> OtherSamplesError | None:
    """Error of a file without a row of the split."""
    present = set(plans.keys)
    if not present.isdisjoint(set().union(*samples.values())):
        return None
    other_splits = (other for other in list_scenes_by_split(data)[0] if other != split)
    own_split = None
    for name in other_splits:
        if own_split is None and not present.isdisjoint(set().union(*plans.samples_of(data, name).values())):
            own_split = name
    recorded_split = find_record_with_samples(
        records, [tuple(json.dumps(part) for part in key) for key in plans.keys[:_MOST_LISTED]]
    )
    seems = "its samples are unknown here; name the data set that it was made for with --data"
    if own_split is not None:
        seems = f"they are samples of its split {own_split!r}; name that with --split"
    elif recorded_split is not None:
        its = f"split {recorded_split.split!r} of {recorded_split.data}"
        seems = f"they are samples of {its}, of which there are records"
    return OtherSamplesError(
        f"{plans.path}: none of its {len(plans.keys)} rows belongs to split {split!r} of {data.name}; {seems}"
    )


def read_plan_file(path: Path, frame: FrameName | None = None) -> PlanFile:
    """Rows of a ``.csv``, ``.parquet`` or ``.json`` plan file, checked, in the order of the file.

    `frame` overrides that of the file. An `InputError` names the first few offenders.
    """
    table = _read_table(path)
    columns = [str(column) for column in table.columns]
    key_columns = _BY_TOKEN if "sample_token" in columns else _BY_TIME
    _require_columns(path, columns, key_columns)
    if len(table) == 0:
        raise InputError(f"{path} has no rows")
    keys = tuple(_row_key(path, key_columns, values) for values in zip(*(table[column] for column in key_columns)))
    _require_unique(path, keys)
    waypoints = _numbers(path, table, keys)
    frames = tuple(str(frame_name) for frame_name in table["frame"])
    wrong = [f"{name!r} ({_format_key(key)})" for name, key in zip(frames, keys) if name not in set(PlanFrame)]
    if wrong:
        raise InputError(f"{path} has the unknown frame {_summarise(wrong)}; use 'lidar' or 'ego'")
    read_as = tuple(PlanFrame(frame or frame_name) for frame_name in frames)
    return PlanFile(path, key_columns == _BY_TOKEN, keys, read_as, waypoints)


def _read_table(path: Path) -> Any:
    if not path.is_file():
        raise InputError(f"there is no plan file {path}")
    kind = path.suffix.lower()
    if kind not in (".csv", ".parquet", ".json"):
        raise InputError(f"{path} is neither .csv, .parquet nor .json")
    try:
        return read_table(path)
    except (ValueError, OSError, AttributeError, TypeError) as error:
        raise InputError(f"{path} cannot be read as {kind[1:]}: {to_one_line(error)}; make it again") from error


def _require_columns(path: Path, columns: list[str], key_columns: tuple[str, ...]) -> None:
    steps = _waypoint_columns(columns)
    expected = (*key_columns, "frame", *steps)
    missing = [column for column in expected if column not in columns]
    if missing:
        hint = "; name rows by sample_token, or by scene and timestamp" if key_columns == _BY_TIME else ""
        raise InputError(f"{path} has no column {', '.join(missing)}{hint}")
    unknown = [column for column in columns if column not in (*expected, *_BY_TOKEN, *_BY_TIME)]
    if unknown:
        raise InputError(
            f"{path} has unknown columns {', '.join(unknown[:_MOST_LISTED])}; use only {', '.join(expected)}"
        )


def _waypoint_columns(columns: Sequence[str]) -> tuple[str, ...]:
    """Columns of waypoints, without gaps up to the last step that the file has."""
    last = max((place for place, name in enumerate(LONGEST_COLUMNS) if name in columns), default=0)
    return LONGEST_COLUMNS[: max(2 * (last // 2 + 1), len(WAYPOINT_COLUMNS))]


def _row_key(path: Path, columns: tuple[str, ...], values: tuple[Any, ...]) -> tuple[Hashable, ...]:
    try:
        if columns == _BY_TIME:
            scene, timestamp = values
            if int(timestamp) != timestamp:
                raise ValueError
            return (str(scene), int(timestamp))
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{path} has the timestamp {values[1]!r}, which is not whole microseconds") from None
    if not isinstance(values[0], str) or not values[0]:
        raise InputError(f"{path} has a row without a sample_token")
    return values


def _numbers(path: Path, table: Any, keys: tuple[tuple[Hashable, ...], ...]) -> Floats:
    import pandas as pd

    # Otherwise they would count as 1 and 0 metres.
    names = _waypoint_columns(list(table.columns))
    truths = [column for column in names if table[column].map(lambda value: isinstance(value, bool)).any()]
    if truths:
        raise InputError(f"{path} has true or false in column {', '.join(truths[:_MOST_LISTED])}; waypoints are metres")
    columns = [pd.to_numeric(table[column], errors="coerce").to_numpy(np.float64) for column in names]
    waypoints: Floats = np.column_stack(columns).reshape(-1, len(names) // 2, 2)
    bad = np.flatnonzero(~np.isfinite(waypoints).all(axis=(1, 2)))
    if len(bad):
        raise InputError(
            f"{path} has waypoints that are not finite numbers for {_format_keys([keys[row] for row in bad])}"
        )
    far = np.flatnonzero(np.abs(waypoints).max(axis=(1, 2), initial=0.0) > FARTHEST_WAYPOINT_M)
    if len(far):
        raise InputError(
            f"{path} has waypoints farther than {FARTHEST_WAYPOINT_M:.0f} m for "
            f"{_format_keys([keys[row] for row in far])}; give metres from the car, not global coordinates"
        )
    return waypoints


def _require_unique(path: Path, keys: Sequence[tuple[Hashable, ...]]) -> None:
    repeated = [key for key, count in Counter(keys).items() if count > 1]
    if repeated:
        raise InputError(f"{path} has more than one row for {_format_keys(repeated)}")


def _format_key(key: tuple[Hashable, ...]) -> str:
    return " at ".join(str(part) for part in key)


def _format_keys(keys: Sequence[tuple[Hashable, ...]]) -> str:
    count = f"{len(keys)} samples" if len(keys) > 1 else "sample"
    return f"{count} {_summarise([_format_key(key) for key in keys])}"


def _summarise(items: Sequence[str]) -> str:
    more = f" and {len(items) - _MOST_LISTED} more" if len(items) > _MOST_LISTED else ""
    return f"{', '.join(items[:_MOST_LISTED])}{more}"
