"""Aggregates, and what keeps runs from being aggregated."""

import math
from collections.abc import Mapping
from typing import Any

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.verification.golden_set import with_nan
from benchmark.records.neuroncap_aggregate import aggregated, why_invalid
from benchmark.records.neuroncap_switches import CODE
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenFolder

_VALID = "passes"


def compare_aggregates(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare all sets of runs."""
    for case in folder.facts("aggregate.json", gaps=True)["cases"]:
        runs, at = with_nan(case["runs"]), comparison.at(case["name"], "aggregate: ")
        why, golden = why_invalid(runs), case["check_validity"]
        at.verdicts("is it complete", (why is None) != (golden == _VALID))
        if why is not None and golden != _VALID:
            at.verdicts("what is incomplete", why.split(" ")[0] not in golden)
        try:
            table = aggregated(runs, CODE)
        except InputError:
            at.verdicts("is it refused", "error" not in case)
            continue
        at.verdicts("is it refused", "error" in case)
        if "error" in case:
            continue
        for level in ("per_sequence", "per_type", "overall"):
            ours, theirs = _flat(getattr(table, level)), _flat(with_nan(case[level]))
            wrong = [not _same(ours.get(key), theirs.get(key)) for key in {*ours, *theirs}]
            at.verdicts(level.replace("_", " "), wrong)


def _flat(table: Mapping[str, Any], before: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
    found: dict[tuple[str, ...], Any] = {}
    for name, value in table.items():
        found |= _flat(value, (*before, name)) if isinstance(value, Mapping) else {(*before, name): value}
    return found


def _same(ours: Any, golden: Any) -> bool:
    if ours is None or golden is None:
        return False
    return bool(ours == golden) or (math.isnan(ours) and isinstance(golden, float) and math.isnan(golden))
