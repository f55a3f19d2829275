"""NeuroNCAP's table as its published code makes it, of drives in its engine with scenarios."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmark.records.drive_schema import DriveRow, PublishedTable
from benchmark.records.neuroncap_aggregate import Metrics, aggregated
from benchmark.records.neuroncap_switches import Switches

ENGINE: Final = "neuroncap@code"
"""The published code rounds; `neuroncap@paper` does not, and has no such table."""
_SCORE, _COLLISION = "ncap_score", "any_collide@0.0s"
"""Names of the published files."""


def published_table(engine: str, rows: Sequence[DriveRow]) -> PublishedTable | None:
    """NeuroNCAP's published table of a record, from its drives.

    ``None`` of another engine, and of scenes that were driven as they are: the published table is of scenarios.
    """
    if engine != ENGINE or not rows or not all(row.family for row in rows):
        return None
    runs: dict[str, dict[str, dict[str, Metrics | None]]] = {}
    for row in rows:
        runs.setdefault(row.family, {}).setdefault(row.scene, {})[f"run_{row.run}"] = _metrics(row)
    found = aggregated(runs, Switches.named(engine))
    return PublishedTable(
        nns=_known(found.overall, _SCORE),
        collision=_known(found.overall, _COLLISION),
        nns_by_family={family: _known(each, _SCORE) for family, each in found.per_type.items()},
        collision_by_family={family: _known(each, _COLLISION) for family, each in found.per_type.items()},
    )


def _metrics(row: DriveRow) -> Metrics | None:
    """Metrics of a run in the published code; a failed run left none, and without labels there are none."""
    if row.scores is None or row.scores.neuroncap is None or row.unlabelled:
        return None
    score = row.scores.neuroncap.score
    return {_SCORE: float("nan") if score is None else score, _COLLISION: row.contact is not None}


def _known(level: dict[str, float], name: str) -> float | None:
    value = level.get(name, float("nan"))
    return None if np.isnan(value) else value
