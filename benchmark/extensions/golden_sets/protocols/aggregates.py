"""Rates of whole sets, averaged as each official code averages, and ``aggregate.json``, of four decimals (% and m)."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from benchmark.constants import HORIZON_STEPS
from benchmark.extensions.golden_sets.protocols.golden_set import ProtocolGoldenScene
from benchmark.extensions.golden_sets.protocols.official import find_complete_samples
from benchmark.geometry import Bools, Floats
from benchmark.metrics.rates import HORIZONS, rates
from benchmark.protocols import PROTOCOLS, ProtocolOutcomes
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder

_COLUMNS: Final = {
    ("uniad", "collision"): "uniad_obj_box_col",
    ("uniad", "obj_col"): "uniad_obj_col",
    ("uniad", "l2"): "uniad_L2",
    ("vad", "collision"): "vad_obj_box_col",
    ("vad", "obj_col"): "vad_obj_col",
    ("vad", "l2"): "vad_L2",
    ("vad-23", "collision"): "vad23_obj_box_col",
    ("vad-23", "obj_col"): "vad23_obj_col",
    ("sparsedrive", "collision"): "sd_obj_box_col",
    ("sparsedrive", "l2"): "sd_L2",
    ("diffusiondrive", "collision"): "sd_obj_box_col",
    ("diffusiondrive", "l2"): "sd_L2",
}
"""Protocol and column of ours, and the array of official per-sample values."""


SceneOutcomes = tuple[ProtocolGoldenScene, Mapping[str, list[ProtocolOutcomes]]]
"""A scene, and for each protocol its verdicts on each plan."""


def compare_rates(comparison: Comparison, judged: list[SceneOutcomes]) -> None:
    """Compare the rates of every plan over the scenes that have it, those with a ghost on the recorded path apart."""
    groups: dict[str, list[SceneOutcomes]] = {}
    for part in judged:
        groups.setdefault("ghost scenes" if part[0].name.startswith("gtcol") else "scenes", []).append(part)
    for group, scenes in groups.items():
        for plan in sorted({name for scene, _ in scenes for name in scene.plan_names}):
            _compare_plan(comparison, group, plan, [part for part in scenes if plan in part[0].plan_names])


def _compare_plan(comparison: Comparison, group: str, plan: str, scenes: list[SceneOutcomes]) -> None:
    names = [scene.name for scene, _ in scenes for _ in scene.truths]
    complete = np.concatenate([find_complete_samples(scene) for scene, _ in scenes])
    for protocol in sorted({name for name, _ in _COLUMNS}, key=list(PROTOCOLS).index):
        judged = join_outcomes([outcomes[protocol][scene.plan_names.index(plan)] for scene, outcomes in scenes])
        column_rates = rates(PROTOCOLS[protocol], judged, names)
        for column in (column for name, column in _COLUMNS if name == protocol):
            golden = np.concatenate(
                [_official(scene, protocol, column)[:, scene.plan_names.index(plan)] for scene, _ in scenes]
            )
            # A plan without a complete sample gives no verdict, and without verdicts there is no rate.
            if protocol != "uniad" and not complete.any():
                continue
            ours = np.array([column_rates[column][horizon].value for horizon in HORIZONS], np.float64)
            quantity = f"{protocol} rates, {group}: {column}" + (" (m)" if column == "l2" else "")
            comparison.numbers(quantity, ours, _average_values(protocol, golden, complete), where=f"plan {plan}")


def _official(scene: ProtocolGoldenScene, protocol: str, column: str) -> Floats:
    """Official values, (S, P, 3) for VAD, (S, P, 6) for the others."""
    last = len(HORIZON_STEPS) if protocol.startswith("vad") else scene.plans.shape[2]
    return scene.official.floats(_COLUMNS[protocol, column], *scene.plans.shape[:2], last)


def _average_values(protocol: str, values: Floats, complete: Bools) -> Floats:
    """The numbers that the official code prints at 1, 2 and 3 s, and their mean."""
    if protocol == "uniad":
        at_horizon = values.mean(axis=0)[[count - 1 for count in HORIZON_STEPS.values()]]
    elif protocol.startswith("vad"):
        at_horizon = values[complete].mean(axis=0)
    else:
        by_step = values[complete].mean(axis=0)
        at_horizon = np.array([by_step[:count].mean() for count in HORIZON_STEPS.values()])
    return np.append(at_horizon, at_horizon.mean())


def join_outcomes(parts: Sequence[ProtocolOutcomes]) -> ProtocolOutcomes:
    """Verdicts of several scenes one after the other."""
    return ProtocolOutcomes(
        collision=np.concatenate([part.collision for part in parts]),
        l2=np.concatenate([part.l2 for part in parts]),
        valid=np.concatenate([part.valid for part in parts]),
        counted=np.concatenate([part.counted for part in parts]),
        steps={name: np.concatenate([part.steps[name] for part in parts]) for name in parts[0].steps},
        facts={name: tuple(fact for part in parts for fact in part.facts[name]) for name in parts[0].facts},
    )


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
_FILE_COLUMNS: Final = {"obj_box_col": "collision", "boundary_box_col": "kerb", "boundary": "off_road", "L2": "l2"}
_MEANS: Final = {"collision": "collision_mean", "l2": "l2_mean"}
"""Columns of the one protocol that has two tables."""


def compare_rate_file(comparison: Comparison, folder: GoldenFolder, judged: list[SceneOutcomes]) -> None:
    """Compare rates of every plan over all scenes with roads but those with a ghost on the recorded path.

    Nothing is compared without the file or with another number of samples, as of a set with files left out.
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
    comparison: Comparison,
    judged: list[SceneOutcomes],
    table: Mapping[str, Any],
    protocol: str,
    whose: str,
    *,
    means: bool,
) -> None:
    names = [scene.name for scene, _ in judged for _ in scene.truths]
    for at, plan in enumerate(judged[0][0].plan_names):
        together = join_outcomes([outcomes[whose][at] for _, outcomes in judged])
        if int(together.counted.sum()) != table.get("samples", table.get("counted")):
            return
        column_rates = rates(PROTOCOLS[protocol], together, names)
        for array, column in _FILE_COLUMNS.items():
            if array in table:
                chosen = column_rates[_MEANS[column] if means else column]
                scale, unit = (1.0, "m") if column == "l2" else (100.0, "%")
                ours = scale * np.array([chosen[horizon].value for horizon in HORIZONS[:3]], np.float64)
                quantity = f"{whose} rates{', means' if means else ''}: {column} ({unit})"
                comparison.numbers(quantity, ours, table[array][plan], where=f"plan {plan}")
