"""Rates over all scenes of a set against its ``aggregate.json``, which has four decimals of per cent and metres."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.protocols.golden_set import GoldenScene
from benchmark.geometry import Floats
from benchmark.machine.storage import read_json
from benchmark.metrics.rates import HORIZONS, rates
from benchmark.protocols import PROTOCOLS, Outcomes
from benchmark.verification.checks import Comparison

AGGREGATE: Final = "aggregate.json"
ROUNDING: Final = 6e-5
"""Half of the last decimal, and some single precision."""
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


class FurtherAggregates:
    """Gathers scenes, then compares the rates over all but those with a ghost on the recorded path."""

    def __init__(self) -> None:
        self._scenes: list[tuple[GoldenScene, Mapping[str, list[Outcomes]]]] = []

    def add(self, scene: GoldenScene, outcomes: Mapping[str, list[Outcomes]]) -> None:
        """Take a scene.

        Args:
            scene: A scene with roads.
            outcomes: Verdicts on each plan, by protocol.
        """
        if not scene.name.startswith("gtcol"):
            self._scenes.append((scene, outcomes))

    def compare(self, comparison: Comparison, folder: Path) -> None:
        """Compare the rates of every plan.

        Args:
            comparison: Where the errors go.
            folder: Directory of the set; without the file nothing is compared, nor with another number of samples,
                which is what a set with files left out has.

        Raises:
            InputError: If the file is damaged.
        """
        if not self._scenes or not (folder / AGGREGATE).is_file():
            return
        stored = read_json(folder / AGGREGATE)
        try:
            for name, kind, protocol, whose in _TABLES:
                table = stored["protocols"][name]
                if kind is not None:
                    table = {"samples": table["samples"], **table[kind]}
                means = kind == "running_mean" and protocol == "opendrivevla"
                self._compare_table(comparison, table, protocol, whose, means=means)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(
                f"{folder / AGGREGATE} lacks rates of a protocol or has them in another form; fetch it again or leave "
                "it away"
            ) from error

    def _compare_table(
        self, comparison: Comparison, table: Mapping[str, Any], protocol: str, whose: str, *, means: bool
    ) -> None:
        names = [scene.name for scene, _ in self._scenes for _ in scene.truths]
        for at, plan in enumerate(self._scenes[0][0].plan_names):
            judged = _joined([outcomes[whose][at] for _, outcomes in self._scenes])
            if int(judged.counted.sum()) != table.get("samples", table.get("counted")):
                return
            found = rates(PROTOCOLS[protocol], judged, names)
            for array, column in _COLUMNS.items():
                if array not in table:
                    continue
                chosen = found[_MEANS[column] if means else column]
                scale = 1.0 if column == "l2" else 100.0
                ours = scale * np.array([chosen[horizon].value for horizon in HORIZONS[:3]], np.float64)
                wanted: Floats = np.array(table[array][plan], np.float64)
                unit = "m" if column == "l2" else "%"
                quantity = f"{whose} rates{', means' if means else ''}: {column} ({unit})"
                comparison.numbers(quantity, ours, wanted, ROUNDING, where=f"plan {plan}")


def _joined(parts: Sequence[Outcomes]) -> Outcomes:
    """Verdicts of several scenes one after the other."""
    return Outcomes(
        collision=np.concatenate([part.collision for part in parts]),
        l2=np.concatenate([part.l2 for part in parts]),
        valid=np.concatenate([part.valid for part in parts]),
        counted=np.concatenate([part.counted for part in parts]),
        steps={name: np.concatenate([part.steps[name] for part in parts]) for name in parts[0].steps},
        facts={name: tuple(fact for part in parts for fact in part.facts[name]) for name in parts[0].facts},
    )
