"""From runs to NeuroNCAP's table: mean over runs, then sequences, then types; so types weigh alike, not runs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.records.neuroncap_switches import Switches

Metrics = Mapping[str, bool | float | None]
"""Of one run, by name; ``None`` where there is nothing to say."""
Runs = Mapping[str, Mapping[str, Mapping[str, Metrics | None]]]
"""Type, sequence, run; ``None`` for a run that left no metrics."""
_DIGITS: Final = 3
_NO_METRIC: Final = "info"
"""Names with this in them are no metrics."""


@dataclass(frozen=True, slots=True)
class Aggregate:
    """The table, by type, sequence and metric; NaN where there was nothing to average."""

    per_sequence: dict[str, dict[str, dict[str, float]]]
    per_type: dict[str, dict[str, float]]
    overall: dict[str, float]


def aggregated(runs: Runs, switches: Switches) -> Aggregate:
    """Average runs; ``switches`` say whether every level is rounded.

    A run without metrics is left out, and a sequence without runs is NaN. A NaN in a run makes its sequence NaN, and
    such a sequence does not count for its type.

    Raises:
        InputError: If a run lacks a metric that the first run has.
    """
    digits = _DIGITS if switches.rounding == "code" else None
    found = (metrics for sequences in runs.values() for each in sequences.values() for metrics in each.values())
    names = [name for name in next((metrics for metrics in found if metrics is not None), {}) if _NO_METRIC not in name]
    per_sequence = {
        family: {name: _of_sequence(each, names, f"{family}-{name}", digits) for name, each in sequences.items()}
        for family, sequences in runs.items()
    }
    per_type = {family: _over(sequences.values(), digits) for family, sequences in per_sequence.items()}
    return Aggregate(per_sequence, per_type, _over(per_type.values(), digits))


def why_invalid(runs: Runs) -> str | None:
    """Reason why runs are no complete result, in a sentence, or ``None``.

    Every sequence needs as many runs as the first one, and each run its metrics.
    """
    wanted: int | None = None
    for family, sequences in runs.items():
        for name, found in sequences.items():
            folder = f"{family}-{name}"
            wanted = len(found) if wanted is None else wanted
            if len(found) != wanted:
                return f"{folder} has {len(found)} runs and the first sequence {wanted}; run what is missing"
            for run, metrics in found.items():
                if metrics is None:
                    return f"{folder}/{run} has no metrics; run it again"
    return None


def _of_sequence(
    runs: Mapping[str, Metrics | None], names: Sequence[str], folder: str, digits: int | None
) -> dict[str, float]:
    found = [metrics for metrics in runs.values() if metrics is not None]
    means = {}
    for name in names:
        if not all(name in metrics for metrics in found):
            raise InputError(f"a run of {folder} has no {name!r}, which the first run has; run it again")
        values = [metrics[name] for metrics in found]
        means[name] = _mean((float(value) for value in values if value is not None), digits)
    return means


def _over(levels: Iterable[Mapping[str, float]], digits: int | None) -> dict[str, float]:
    """Mean of each metric over those that have it, NaN left out."""
    listed = list(levels)
    names = dict.fromkeys(name for level in listed for name in level)
    kept = {name: [level[name] for level in listed if name in level and not np.isnan(level[name])] for name in names}
    return {name: _mean(values, digits) for name, values in kept.items()}


def _mean(values: Iterable[float], digits: int | None) -> float:
    listed = list(values)
    # numpy's mean and rounding: `sum` gives another third digit where it is a tie.
    mean = float(np.mean(listed)) if listed else float("nan")
    return mean if digits is None else float(np.round(mean, digits))
