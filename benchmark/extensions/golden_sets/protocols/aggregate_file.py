"""Rates over all scenes of a set against its ``aggregate.json``, which has four decimals of per cent and metres."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from benchmark.extensions.golden_sets.protocols.aggregates import Judged, joined
from benchmark.metrics.rates import HORIZONS, rates
from benchmark.protocols import PROTOCOLS
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenFolder

AGGREGATE: Final = "aggregate.json"
_Table = tuple[str, str | None, str, str]
_TABLES: Final[tuple[_Table, ...]] = (
    ("stp3", None, "stp3", "stp3"),
    ("bevp", None, "bev-planner", "bev-planner"),
    ("omni", None, "omnidrive", "omnidrive, unrounded"),
    ("omni_text", None, "omnidrive", "omnidrive"),
    ("ad_uniad", "at_step", "agent-driver", "agent-driver"),
    ("ad_stp3", "running_mean", "agent-driver-stp3", "agent-driver-stp3"),
    ("od_vehicle", "at_step", "opendrivevla", "opendrivevla"),
    ("od_vehicle", "running_mean", "opendrivevla", "opendrivevla"),
    ("od_all", "running_mean", "opendrivevla-stp3", "opendrivevla-stp3"),
    ("smv_raster", None, "safemvdrive", "safemvdrive"),
    ("smv_box", None, "safemvdrive-box", "safemvdrive-box"),
    ("smv_box_all", None, "safemvdrive-box-all", "safemvdrive-box-all"),
)
"""Name in the file, which of two tables there, protocol, and whose verdicts."""
_COLUMNS: Final = {"obj_box_col": "collision", "boundary_box_col": "kerb", "boundary": "off_road", "L2": "l2"}
_MEANS: Final = {"collision": "collision_mean", "l2": "l2_mean"}
"""Columns of the one protocol that has two tables."""


def compare_rate_file(comparison: Comparison, folder: GoldenFolder, judged: list[Judged]) -> None:
    """Compare the rates of every plan over all scenes with roads but those with a ghost on the recorded path.

    Without the file nothing is compared, nor with another number of samples, which is what a set with files left out
    has.
    """
    judged = [(scene, outcomes) for scene, outcomes in judged if not scene.name.startswith("gtcol")]
    if not judged or not folder.has(AGGREGATE):
        return
    stored = folder.facts(AGGREGATE)["protocols"]
    for name, kind, protocol, whose in _TABLES:
        table = stored[name] if kind is None else {"samples": stored[name]["samples"], **stored[name][kind]}
        means = kind == "running_mean" and protocol == "opendrivevla"
        _compare_table(comparison, judged, table, protocol, whose, means=means)


def _compare_table(
    comparison: Comparison, judged: list[Judged], table: Mapping[str, Any], protocol: str, whose: str, *, means: bool
) -> None:
    names = [scene.name for scene, _ in judged for _ in scene.truths]
    for at, plan in enumerate(judged[0][0].plan_names):
        together = joined([outcomes[whose][at] for _, outcomes in judged])
        if int(together.counted.sum()) != table.get("samples", table.get("counted")):
            return
        found = rates(PROTOCOLS[protocol], together, names)
        for array, column in _COLUMNS.items():
            if array in table:
                chosen = found[_MEANS[column] if means else column]
                scale, unit = (1.0, "m") if column == "l2" else (100.0, "%")
                ours = scale * np.array([chosen[horizon].value for horizon in HORIZONS[:3]], np.float64)
                quantity = f"{whose} rates{', means' if means else ''}: {column} ({unit})"
                comparison.numbers(quantity, ours, table[array][plan], where=f"plan {plan}")
