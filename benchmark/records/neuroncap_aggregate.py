"""From runs to NeuroNCAP's table: mean over runs, then sequences, then types; so types weigh alike, not runs.

`NeuroncapSwitches` has one switch for each place where its published code parts from its paper, comments or sense.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, Literal, Self

import numpy as np

from benchmark.errors import InputError, did_you_mean

Reading = Literal["code", "paper"]
_ENGINE: Final = "neuroncap@"


@dataclass(frozen=True, slots=True)
class NeuroncapSwitches:
    """Reading of each quirk.

    Attributes:
        reference_speed: Ego speed of the reference impact: of the recording's last two frames, or four seconds after
            the start.
        reference_dt: Time between those frames: half a second always, or as the stamps say.
        box_centre: Centre of the ego's box ahead of the rear axle: 0.5 m (UniAD's, from the lidar), or 1.39 m.
        ego_length: 4.018 m in single precision, or the car's 4.084 m.
        contact_prefilter: Actors far from the rear axle are not looked at, or all are.
        impact_speed_of_ego: Speed of another car's centre put along the heading, or of the rear axle.
        impact_norm: Impact speed in space, or in the plane.
        last_state: The state that the last step reaches is not checked, or it is.
        first_gap: No sub-steps between the last primed state and the first driven one, or ten.
        time_step_of_actors: Poses that divide the duration unevenly, or one each half second.
        actor_window: Actors from the start frame without jitter, or from the jittered one.
        jitter_times: Jitter of an actor's times is not read, or it is drawn after the others.
        start_jitter_stream: The start frame has a generator of its own with the same seed, or the scenario's.
        steering_index: The wheel angle is read at frame ``priming``, or at the frame where driving starts.
        reinsertion: The car is put back to the plan's origin at each sub-step, or moves through the plan.
        vehicle: Wheelbase and centre of a Chrysler Pacifica, or of the recording car.
        acceleration_clip: Acceleration is limited after steering has used it, or before.
        can_acceleration: Centripetal part with the wrong sign and nothing sideways, or that of the box centre.
        float32: Where the code rounds to single precision, or nowhere.
        command_extension: The path goes on along its last step, or along its last step that moves.
        classes: Construction and emergency vehicles cannot be hit, or all vehicles can.
        plan_3s: The plan's check at 3 s uses its waypoint of 2.5 s, or that of 3 s.
        dims_jitter: Sizes that are jittered grow from run to run, or are those of the run.
        rounding: Three digits at every level of the aggregate, or none.
    """

    reference_speed: Reading = "code"
    reference_dt: Reading = "code"
    box_centre: Reading = "code"
    ego_length: Reading = "code"
    contact_prefilter: Reading = "code"
    impact_speed_of_ego: Reading = "code"
    impact_norm: Reading = "code"
    last_state: Reading = "code"
    first_gap: Reading = "code"
    time_step_of_actors: Reading = "code"
    actor_window: Reading = "code"
    jitter_times: Reading = "code"
    start_jitter_stream: Reading = "code"
    steering_index: Reading = "code"
    reinsertion: Reading = "code"
    vehicle: Reading = "code"
    acceleration_clip: Reading = "code"
    can_acceleration: Reading = "code"
    float32: Reading = "code"
    command_extension: Reading = "code"
    classes: Reading = "code"
    plan_3s: Reading = "code"
    dims_jitter: Reading = "code"
    rounding: Reading = "code"

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value not in ("code", "paper"):
                raise InputError(f"switch {field.name} of NeuroNCAP must be code or paper, not {value!r}")

    @classmethod
    def named(cls, name: str) -> Self:
        """Switches by ``neuroncap@code`` or ``neuroncap@paper``, with departures as `name` writes them."""
        preset, *departures = name.removeprefix(_ENGINE).split("+")
        if not name.startswith(_ENGINE) or preset not in ("code", "paper"):
            raise InputError(f"{name!r} is not an engine of NeuroNCAP; use neuroncap@code or neuroncap@paper")
        known = [field.name for field in fields(cls)]
        changed = dict(departure.partition("=")[::2] for departure in departures)
        for switch in changed:
            if switch not in known:
                hint = did_you_mean(switch, known)
                raise InputError(f"NeuroNCAP's engine has no switch {switch!r}; {hint}known are {', '.join(known)}")
        values: dict[str, Any] = {**dict.fromkeys(known, preset), **changed}
        return cls(**values)

    @property
    def name(self) -> str:
        """Name of the measurement: the nearer preset (``code`` on a tie), and the switches that depart from it."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        preset = "code" if 2 * list(values.values()).count("code") >= len(values) else "paper"
        departures = [f"+{switch}={value}" for switch, value in values.items() if value != preset]
        return _ENGINE + preset + "".join(departures)


CODE: Final = NeuroncapSwitches.named("neuroncap@code")
PAPER: Final = NeuroncapSwitches.named("neuroncap@paper")


Metrics = Mapping[str, bool | float | None]
"""Of one run, by name; ``None`` where there is nothing to say."""
Runs = Mapping[str, Mapping[str, Mapping[str, Metrics | None]]]
"""Type, sequence, run; ``None`` for a run that left no metrics."""
_DIGITS: Final = 3
_NO_METRIC: Final = "info"
"""Names with this in them are no metrics."""


@dataclass(frozen=True, slots=True)
class NeuroncapAggregate:
    """The table, by type, sequence and metric; NaN where there was nothing to average."""

    per_sequence: dict[str, dict[str, dict[str, float]]]
    per_type: dict[str, dict[str, float]]
    overall: dict[str, float]


def aggregate_runs(runs: Runs, switches: NeuroncapSwitches) -> NeuroncapAggregate:
    """Average runs; ``switches`` say whether every level is rounded.

    A run without metrics is left out, and a sequence without runs is NaN. A NaN in a run makes its sequence NaN, and
    such a sequence does not count for its type. A run that lacks a metric of the first run is refused.
    """
    digits = _DIGITS if switches.rounding == "code" else None
    metrics_of_runs = (
        metrics
        for sequences in runs.values()
        for sequence_runs in sequences.values()
        for metrics in sequence_runs.values()
    )
    names = [
        name
        for name in next((metrics for metrics in metrics_of_runs if metrics is not None), {})
        if _NO_METRIC not in name
    ]
    per_sequence = {
        family: {
            name: _of_sequence(sequence_runs, names, f"{family}-{name}", digits)
            for name, sequence_runs in sequences.items()
        }
        for family, sequences in runs.items()
    }
    per_type = {family: _over(sequences.values(), digits) for family, sequences in per_sequence.items()}
    return NeuroncapAggregate(per_sequence, per_type, _over(per_type.values(), digits))


def find_invalid_reason(runs: Runs) -> str | None:
    """Reason why runs are no complete result, in a sentence, or ``None``.

    Every sequence needs as many runs as the first one, and each run its metrics.
    """
    wanted: int | None = None
    for family, sequences in runs.items():
        for name, sequence_runs in sequences.items():
            folder = f"{family}-{name}"
            wanted = len(sequence_runs) if wanted is None else wanted
            if len(sequence_runs) != wanted:
                return f"{folder} has {len(sequence_runs)} runs and the first sequence {wanted}; run the missing ones"
            for run, metrics in sequence_runs.items():
                if metrics is None:
                    return f"{folder}/{run} has no metrics; run it again"
    return None


def _of_sequence(
    runs: Mapping[str, Metrics | None], names: Sequence[str], folder: str, digits: int | None
) -> dict[str, float]:
    metrics_of_runs = [metrics for metrics in runs.values() if metrics is not None]
    means = {}
    for name in names:
        if not all(name in metrics for metrics in metrics_of_runs):
            raise InputError(f"a run of {folder} has no {name!r}, which the first run has; run it again")
        values = [metrics[name] for metrics in metrics_of_runs]
        means[name] = _mean((float(value) for value in values if value is not None), digits)
    return means


def _over(levels: Iterable[Mapping[str, float]], digits: int | None) -> dict[str, float]:
    """Mean of each metric over those that have it, NaN left out."""
    listed = list(levels)
    names = dict.fromkeys(name for level in listed for name in level)
    values_by_name = {
        name: [level[name] for level in listed if name in level and not np.isnan(level[name])] for name in names
    }
    return {name: _mean(values, digits) for name, values in values_by_name.items()}


def _mean(values: Iterable[float], digits: int | None) -> float:
    listed = list(values)
    # numpy's mean and rounding: `sum` gives another third digit where it is a tie.
    mean = float(np.mean(listed)) if listed else float("nan")
    return mean if digits is None else float(np.round(mean, digits))
