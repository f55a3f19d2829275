"""Where NeuroNCAP's published code parts from its paper, its own comments or sense: one switch each.

`CODE` is the published code to the last quirk, for comparison with published numbers; `PAPER` is what paper, documents
and comments say, and what a sane engine does where they say nothing. docs/extensions/neuroncap.md has the table in
words.
"""

from dataclasses import dataclass, fields
from typing import Any, Final, Literal, Self

from benchmark.errors import InputError, did_you_mean

Reading = Literal["code", "paper"]
_ENGINE: Final = "neuroncap@"


@dataclass(frozen=True, slots=True)
class Switches:
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
                raise InputError(f"switch {field.name} of NeuroNCAP is code or paper, not {value!r}")

    @classmethod
    def named(cls, name: str) -> Self:
        """Switches by ``neuroncap@code`` or ``neuroncap@paper``, with departures as `name` writes them.

        Raises:
            InputError: If there is no such preset or switch.
        """
        preset, *departures = name.removeprefix(_ENGINE).split("+")
        if not name.startswith(_ENGINE) or preset not in ("code", "paper"):
            raise InputError(f"{name!r} is no engine of NeuroNCAP; there are neuroncap@code and neuroncap@paper")
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
        """Name of the measurement with them: a preset, and the switches that depart from it by name.

        The nearer preset is named, ``code`` where both are as near.
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        preset = "code" if 2 * list(values.values()).count("code") >= len(values) else "paper"
        departures = [f"+{switch}={value}" for switch, value in values.items() if value != preset]
        return _ENGINE + preset + "".join(departures)


CODE: Final = Switches.named("neuroncap@code")
PAPER: Final = Switches.named("neuroncap@paper")
