"""Weights of the terms that ask a candidate to threaten the ego, all 0 in the paper; sources of candidates."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Self

import numpy as np

from benchmark.errors import InputError


def parse_setting(name: str, text: str, kind: type) -> Any:
    """A value of the type that a hyper-parameter has: a switch, a finite number or a `StrEnum`."""
    if kind is bool:
        if text not in ("true", "false"):
            raise InputError(f"hyper-parameter {name} is a switch, true or false, not {text!r}")
        return text == "true"
    try:
        value = kind(text)
    except ValueError as error:
        choices = f"one of {', '.join(kind)}" if issubclass(kind, StrEnum) else f"a number ({kind.__name__})"
        raise InputError(f"hyper-parameter {name} must be {choices}, not {text!r}") from error
    if isinstance(value, float) and not np.isfinite(value):
        raise InputError(f"hyper-parameter {name} must be finite, not {text!r}")
    return value


class CandidateProposal(StrEnum):
    """Source of an adversary's motion.

    ``SAMPLED``: the diffusion model, refined and scored. ``RETIMED``: its recorded path with other timing.
    ``REROUTED``: lanes that it did not take, from standing too. ``SWERVED``: as recorded, but nearer to the ego
    where it passes it. The latter three are of the extension ``effect``.
    """

    SAMPLED = "sampled"
    RETIMED = "retimed"
    REROUTED = "rerouted"
    SWERVED = "swerved"


class EgoDriver(StrEnum):
    """Who drives the ego while a scene is made.

    ``RECORDED``: as recorded. ``IDM`` keeps distance, ``CAREFUL`` is the careful and competent human: reference drivers
    of `benchmark.interactions` on the recorded path, by the extension ``reactive_adversary``.
    """

    RECORDED = "recorded"
    IDM = "idm"
    CAREFUL = "careful"


@dataclass(frozen=True, slots=True)
class ThreatSettings:
    """Terms that `generation.search.threat` adds to a score; ``docs/generation.md`` has the equations.

    Attributes:
        threat_weight: Of the distance to where an ego that does not react would run into the candidate.
        threat_gap_s: Time gap ahead of the ego that is aimed at where the ego does not brake.
        threat_least_m: Least room ahead of the ego that is aimed at.
        closing_weight: Reward for a candidate in the ego's way that the ego closes on, in time for a careful human.
        careful_weight: Of being in the ego's way nearer than a careful human can brake for.
        side_weight: Of a side clearance that is too small for the ego's speed.
        side_least_m: Side clearance beside an ego that all but stands.
        side_s: Further side clearance for each m/s of the ego.
        behind_weight: Of being behind an ego that moves, where nothing that it does is a threat.
        against_weight: Of heading against the lane below.
        hover_weight: Of bodies within half a metre, the ego's or others'.
        likelihood_weight: Of accelerations that recorded drivers rarely ask for.
        area_weight: Of nearing the edge of the area around the ego.
        least_overrun_m: With ``launch=reach`` a vehicle is tried only if it can be in the ego's way before an ego that
            does not react would overrun the recorded one by so much more than the air that is kept. 0 does not ask.
        ahead_weight: Of not being ahead of the ego where the scores end. In closed loop a vehicle is no threat to an
            ego that has passed it; the recording of open loop never passes a vehicle that it did not.
        careful_survives: Whether a scene is dropped in which a careful and competent human touches another.
        vulnerable: Whether cyclists and pedestrians are tried too; only with ``proposal=retimed``, and on foot or by
            bicycle no road limits them.
        behaviour: Whether a scene is dropped in which the adversary has a fault of behaviour (``docs/realism.md``).
    """

    threat_weight: float = 0.0
    threat_gap_s: float = 0.6
    threat_least_m: float = 1.0
    closing_weight: float = 0.0
    careful_weight: float = 0.0
    side_weight: float = 0.0
    side_least_m: float = 0.8
    side_s: float = 0.05
    behind_weight: float = 0.0
    against_weight: float = 0.0
    hover_weight: float = 0.0
    likelihood_weight: float = 0.0
    area_weight: float = 0.0
    least_overrun_m: float = 0.0
    ahead_weight: float = 0.0
    careful_survives: bool = False
    vulnerable: bool = False
    behaviour: bool = False

    @property
    def threatens(self) -> bool:
        """Whether any of the terms has a weight."""
        return any((
            self.threat_weight, self.closing_weight, self.careful_weight, self.side_weight, self.behind_weight,
            self.against_weight, self.hover_weight, self.likelihood_weight, self.area_weight, self.ahead_weight,
        ))  # fmt: skip

    def where_asked(self) -> Self:
        """Without the terms that say where to be: a manoeuvre that was asked for says that."""
        return replace(
            self,
            threat_weight=0.0,
            closing_weight=0.0,
            side_weight=0.0,
            behind_weight=0.0,
            hover_weight=0.0,
            ahead_weight=0.0,
        )


NEUTRAL = ThreatSettings()
"""All terms off: what searches had before there were any."""
