"""Do scenes that break one planner break another: the surrogate-filtered matrix of the paper's appendix.

A scene fails a planner if any counted sample of it collides at any step (`benchmark.records.scene_failures`). Cell
(surrogate, victim) is the share of the surrogate's failed scenes that the victim fails too. It is not symmetric, and
the victim's failure rate over all scenes (``base_rates``) belongs beside it: transfer is what exceeds that.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.errors import InputError
from benchmark.rates import Rate, ratios_over_scenes
from benchmark.records import RunRecord, scene_failures


@dataclass(frozen=True, slots=True)
class TransferMatrix:
    """Failure transfer between planners on one split.

    Attributes:
        protocol: Who judged the collisions.
        split: Name of the split.
        planners: Names of P planners, in the order given.
        privileged: P flags: whether the planner saw what no car sees.
        cells: P x P, first index surrogate, second victim. ``denominator`` counts the scenes that the surrogate fails
            and both were judged on, ``numerator`` those that the victim fails too; ``value`` is ``None`` (a dash)
            where the surrogate fails none. The diagonal is 1 by construction.
        base_rates: P rates of failed scenes over all scenes that the planner was judged on.
        undecided: P lists of scenes without a verdict for the planner; they are in no denominator of it.
    """

    protocol: str
    split: str
    planners: tuple[str, ...]
    privileged: tuple[bool, ...]
    cells: tuple[tuple[Rate, ...], ...]
    base_rates: tuple[Rate, ...]
    undecided: tuple[tuple[str, ...], ...]


def transfer(records: Sequence[RunRecord], *, protocol: str = "exact", seed: int = 0) -> TransferMatrix:
    """Transfer matrix of several planners on the same scenes.

    Args:
        records: One for each planner.
        protocol: Whose verdicts count.
        seed: Seed of the intervals.

    Returns:
        The matrix.

    Raises:
        InputError: If there is no record, a planner appears twice, the records are not of the same data and split, or a
            record was not judged by the protocol.
    """
    _require_comparable(records, protocol)
    verdicts = [scene_failures(record.rows, protocol) for record in records]
    every_scene = sorted({scene for verdict in verdicts for scene in verdict})
    return TransferMatrix(
        protocol=protocol,
        split=records[0].run.split,
        planners=tuple(record.planner for record in records),
        privileged=tuple(record.run.planner.privileged for record in records),
        cells=tuple(tuple(_cell(surrogate, victim, seed) for victim in verdicts) for surrogate in verdicts),
        base_rates=tuple(_cell(dict.fromkeys(verdict, True), verdict, seed) for verdict in verdicts),
        undecided=tuple(tuple(scene for scene in every_scene if verdict.get(scene) is None) for verdict in verdicts),
    )


def _cell(surrogate: dict[str, bool | None], victim: dict[str, bool | None], seed: int) -> Rate:
    scenes = [scene for scene, failed in surrogate.items() if failed is not None and victim.get(scene) is not None]
    selected = np.array([[float(surrogate[scene] is True)] for scene in scenes]).reshape(-1, 1)
    both = np.array([[float(victim[scene] is True)] for scene in scenes]).reshape(-1, 1) * selected
    return ratios_over_scenes(both, selected, scenes, seed=seed)[0]


def _require_comparable(records: Sequence[RunRecord], protocol: str) -> None:
    if not records:
        raise InputError("a transfer matrix needs run records and there are none; run challenger-bench eval first")
    names = [record.planner for record in records]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(f"more than one record of {', '.join(repeated)} on this split; name the ones to compare")
    first = records[0].run
    for record in records:
        run = record.run
        if (run.data.fingerprint, run.split) != (first.data.fingerprint, first.split):
            raise InputError(
                f"{record.directory} is split {run.split!r} of {run.data.name!r} and {records[0].directory} is split "
                f"{first.split!r} of {first.data.name!r} with other content; transfer compares records of the same "
                "scenes"
            )
        if protocol not in run.protocols:
            raise InputError(
                f"{record.directory} was not judged by protocol {protocol!r}, only by {', '.join(run.protocols)}"
            )
