"""Contributions of a record's samples to its collision rates, for all comparisons of records."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.metrics.rates import HORIZONS, SceneSums, append_average, sum_by_scene
from benchmark.protocols import LEAVING_OUT, MAXIMA, PROTOCOLS, compute_published_values
from benchmark.records.run import RunRecord, collect_outcomes, resolve_protocol
from benchmark.records.run_schema import find_source

_SOURCES: Final = "sources of scenes"
_MAX_CACHED: Final = 16
"""Sums that are remembered of one record: planners that fail on samples share other samples with each other one."""


@dataclass(frozen=True, slots=True)
class ScoredSamples:
    """Contribution of each sample with a plan to its record's collision rates under one protocol, never ``native``.

    ``values`` are (S, 4), at 1, 2, 3 s and their mean, 0..1, NaN where the sample says nothing; ``counted`` is (S,),
    whether the sample counts and its collisions are known; ``failed`` samples have no plan.
    """

    record: RunRecord
    protocol: str
    tokens: tuple[str, ...]
    scenes: tuple[str, ...]
    values: Floats
    counted: Bools
    failed: frozenset[str]
    kept: dict[bytes, tuple[Mapping[str, str], SceneSums]] = field(default_factory=dict, repr=False, compare=False)

    def sums(self, unit_of: Mapping[str, str], only: Sequence[int] | NDArray[np.int64] | None = None) -> SceneSums:
        """Add the samples up, or those in ``only``, by what ``unit_of`` says each scene is drawn together with."""
        rows = np.arange(len(self.tokens)) if only is None else np.asarray(only, dtype=np.int64)
        # A planner is compared with all others, mostly on the same samples.
        key = hashlib.sha256(rows.tobytes()).digest()
        if key not in self.kept or self.kept[key][0] != unit_of:
            if len(self.kept) >= _MAX_CACHED:
                self.kept.clear()
            self.kept[key] = unit_of, self._sums(unit_of, rows)
        return self.kept[key][1]

    def _sums(self, unit_of: Mapping[str, str], rows: NDArray[np.int64]) -> SceneSums:
        # A scene without verdicts is not drawn either.
        rows = rows[~np.isnan(self.values[rows]).all(axis=1)]
        values = self.values[rows]
        is_known = ~np.isnan(values)
        weights = (is_known & self.counted[rows, None]).astype(np.float64)
        values = np.where(is_known, values, 0.0) * weights
        return sum_by_scene(values, weights, [unit_of[self.scenes[row]] for row in rows])


def find_protocol_version(protocol: str) -> int | None:
    """Version of a protocol as it is now, ``None`` if there is none of this name."""
    return PROTOCOLS[protocol].version if protocol in PROTOCOLS else None


def takes_maxima(protocol: str) -> bool:
    """Whether an official protocol's collision rate is any contact up to the horizon: no mean, no value at a step."""
    return protocol in MAXIMA


def leaves_out_samples(protocol: str) -> bool:
    """Whether a protocol leaves out whole samples because of the recorded ego, where others mask steps."""
    return protocol in LEAVING_OUT


def score_record(record: RunRecord, *, protocol: str = "exact") -> ScoredSamples:
    """Read a record's verdicts under one protocol; ``native`` is that of the planner's own repository."""
    name = resolve_protocol(record, protocol)
    require_current(record, name)
    columns = record.columns
    outcomes = collect_outcomes(record.rows, name)
    return ScoredSamples(
        record=record,
        protocol=name,
        tokens=columns.planned_tokens,
        scenes=columns.planned_scenes,
        values=append_average(compute_published_values(PROTOCOLS[name], outcomes)["collision"]).reshape(
            -1, len(HORIZONS)
        ),
        counted=outcomes.decided,
        failed=columns.failed_tokens,
    )


def require_current(record: RunRecord, protocol: str) -> None:
    """Refuse verdicts that are not those of the protocol, never ``native``, in its present version."""
    judged, now = record.run.protocols.get(protocol), find_protocol_version(protocol)
    where = describe_record(record)
    if judged is None:
        raise InputError(f"{where} was not judged by protocol {protocol!r}; run challenger-bench rescore")
    if now is None:
        raise InputError(
            f"{where} was judged by protocol {protocol!r}, which is not installed; install the package that defines it"
        )
    if judged != now:
        raise InputError(
            f"{where} was judged by version {judged} of protocol {protocol}, now {now}; run challenger-bench rescore"
        )


def map_scenes_to_sources(record: RunRecord) -> Mapping[str, str]:
    """The recording that each scene was made from, itself where the record does not say; shared, not to be changed."""
    cache, run = record.columns.kept, record.run
    if (known := cache.get(_SOURCES)) is None or known[0] is not run:
        source_of = {name: find_source(name, run.scene_facts) for name in run.scenes}
        known = cache[_SOURCES] = run, MappingProxyType(source_of)
    sources: Mapping[str, str] = known[1]
    return sources


def describe_record(record: RunRecord) -> str:
    """A record in words; its path would make tables differ from machine to machine."""
    return f"{record.planner} on {record.run.split} of {record.run.data.name}"
