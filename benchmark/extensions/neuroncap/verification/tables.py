"""Aggregates, and what keeps runs from being aggregated."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.verification.golden_set import NcapFacts
from benchmark.records.neuroncap_aggregate import aggregated, why_invalid
from benchmark.records.neuroncap_switches import CODE
from benchmark.verification.checks import Comparison

_VALID = "passes"


def compare_aggregates(comparison: Comparison, path: Path) -> None:
    """Compare all sets of runs.

    Args:
        comparison: Takes the errors.
        path: ``aggregate.json``.

    Raises:
        InputError: If the file cannot be used.
    """
    for case in NcapFacts.read(path).objects("cases"):
        where, runs = case.text("name"), case.table("runs")
        _require_runs(runs, path, where)
        why, golden = why_invalid(runs), case.text("check_validity")
        comparison.verdicts("aggregate: is it complete", np.array([(why is None) != (golden == _VALID)]), where=where)
        if why is not None and golden != _VALID:
            folder = why.split(" ")[0]
            comparison.verdicts("aggregate: what is incomplete", np.array([folder not in golden]), where=where)
        try:
            table = aggregated(runs, CODE)
        except InputError:
            comparison.verdicts("aggregate: is it refused", np.array(["error" not in case]), where=where)
            continue
        comparison.verdicts("aggregate: is it refused", np.array(["error" in case]), where=where)
        if "error" in case:
            continue
        for level in ("per_sequence", "per_type", "overall"):
            ours, theirs = _flat(getattr(table, level)), _flat(case.table(level))
            wrong = [not _same(ours.get(key), theirs.get(key)) for key in {*ours, *theirs}]
            comparison.verdicts(f"aggregate: {level.replace('_', ' ')}", np.array(wrong), where=where)


def _require_runs(runs: Mapping[str, Any], path: Path, where: str) -> None:
    for sequences in runs.values():
        for found in sequences.values() if isinstance(sequences, Mapping) else [None]:
            if not isinstance(found, Mapping) or not all(each is None or _is_metrics(each) for each in found.values()):
                raise InputError(f"{path}: the runs of {where} are not types of sequences of runs; get the file again")


def _is_metrics(value: Any) -> bool:
    return isinstance(value, Mapping) and all(
        "info" in name or metric is None or isinstance(metric, int | float) for name, metric in value.items()
    )


def _flat(table: Mapping[str, Any], before: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    found: dict[tuple[str, ...], Any] = {}
    for name, value in table.items():
        found |= _flat(value, (*before, name)) if isinstance(value, Mapping) else {(*before, name): value}
    return found


def _same(ours: Any, golden: Any) -> bool:
    if ours is None or golden is None:
        return False
    return bool(ours == golden) or (math.isnan(ours) and isinstance(golden, float) and math.isnan(golden))
