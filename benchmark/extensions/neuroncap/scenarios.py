"""NeuroNCAP's scenarios as data: what is put in the way, and how much of it is drawn."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError, did_you_mean
from benchmark.geometry import Floats
from benchmark.untrusted.text_files import read_json

OFFICIAL_FILE: Final = Path(__file__).parent / "assets" / "official_scenarios.json"
STEP_S: Final = 0.5
"""The only step that the engine takes."""
_NO_ACTORS: Final = 1
"""Primed steps without a scenario."""


@dataclass(frozen=True, slots=True)
class Jitter:
    """Limits of an actor's random offsets, in either direction; ``None`` where nothing is drawn.

    `longitudinal` and `lateral` (to the right) are metres along and across `angle`, the direction of the actor's road
    in radians, and are not drawn without it; `yaw` is in radians. `times` are seconds for each of the actor's times,
    where official ones have more of them than there are times; the published code does not read it. Draws are
    `uniform`, or normal with the limits as standard deviations.
    """

    longitudinal: float | None = None
    lateral: float | None = None
    angle: float | None = None
    yaw: float | None = None
    times: tuple[float, ...] | None = None
    uniform: bool = True


@dataclass(frozen=True, slots=True)
class ScenarioActor:
    """Actor that a scenario puts into the scene: one of `uuids` is drawn, unless it is a single ``uuid``.

    Attributes:
        mode: ``override``: a track of the scenario's own; ``optimized``: the renderer's.
        times: (P,) seconds since the first frame.
        positions: (P, 3) of the middle of its bottom, metres.
        initial_yaw: Heading where it stands, radians.
        flipped: Those of ``uuids`` that are turned round where they stand.
        exclusive_group: Of actors in one group, only the first drawn is there.
        size: (3,) width, length, height instead of the renderer's.
    """

    mode: Literal["override", "optimized"]
    uuids: tuple[str, ...]
    drawn: bool
    is_target: bool = False
    times: Floats | None = None
    positions: Floats | None = None
    initial_yaw: float = 0.0
    flipped: tuple[str, ...] = ()
    exclusive_group: str | None = None
    size: Floats | None = None
    jitter: Jitter | None = None


@dataclass(frozen=True, slots=True)
class Scenario:
    """One scenario of one recording, with the recorded ego for `priming_steps`; the run lasts `duration_s`.

    The start is drawn by `start_jitter` frames, sizes by a share `dim_jitter`, either way. Without inserted `actors`
    the recording's own stay.
    """

    start_frame: int = 0
    priming_steps: int = _NO_ACTORS
    duration_s: float = 20.0
    start_jitter: int = 0
    dim_jitter: float = 0.0
    actors: tuple[ScenarioActor, ...] = ()

    @classmethod
    def of(cls, facts: Mapping[str, Any], where: str) -> Self:
        """A scenario from a file of NeuroNCAP's, whose names may have ``-`` for ``_`` and whose step must be 0.5 s."""
        general = _ScenarioTable(_require_mapping(facts, where).get("general"), f"{where}, general")
        step = general.number("time_step", STEP_S)
        if step != STEP_S:
            raise InputError(f"{where} sets steps of {step} s; this engine supports {STEP_S} s")
        actors = facts.get("actors") or []
        if not isinstance(actors, list):
            raise InputError(f"{where}: actors is not a list")
        listed = tuple(
            _read_actor(_ScenarioTable(actor_value, f"{where}, actor {number}"))
            for number, actor_value in enumerate(actors)
        )
        if sum(actor.is_target for actor in listed) > 1:
            raise InputError(f"{where} has more than one target actor; leave one")
        return cls(
            start_frame=general.whole("start_frame", 0),
            priming_steps=general.whole("priming_steps", _NO_ACTORS),
            duration_s=general.number("duration", 20.0),
            start_jitter=general.whole("start_jitter", 0),
            dim_jitter=general.number("dim_jitter", 0.0),
            actors=listed,
        )

    @property
    def draws(self) -> bool:
        """Whether two runs of it can differ."""
        choices = len(self.actors) > 1 or any(len(actor.uuids) > 1 for actor in self.actors)
        return bool(self.start_jitter or self.dim_jitter or choices or any(actor.jitter for actor in self.actors))


@dataclass(frozen=True, slots=True)
class OfficialScenario:
    """One of NeuroNCAP's own, of four-digit nuScenes `sequence`; one is not `evaluated`: no part of the benchmark."""

    family: str
    sequence: str
    scenario: Scenario
    evaluated: bool


@functools.cache
def read_official_scenarios() -> tuple[OfficialScenario, ...]:
    """NeuroNCAP's scenarios, in the order of its families; numbers (c) the NeuroNCAP authors, MIT licence."""
    rows = read_json(OFFICIAL_FILE)["scenarios"]
    return tuple(
        OfficialScenario(
            family=row["family"],
            sequence=row["sequence"],
            scenario=Scenario.of(row, f"{OFFICIAL_FILE.name} {row['family']}/{row['sequence']}"),
            evaluated=row["evaluated"],
        )
        for row in rows
    )


def _require_mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where} is not a table of names and values, so not a scenario of NeuroNCAP")
    return value


class _ScenarioTable:
    """Values of a table, under their names with ``_``; ``null`` is absent."""

    def __init__(self, value: Any, where: str) -> None:
        self.where = where
        self._values = {str(k).replace("-", "_"): v for k, v in _require_mapping(value, where).items() if v is not None}

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def number(self, name: str, default: float) -> float:
        value = self._values.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise InputError(f"{self.where}: {name} is not a finite number")
        return float(value)

    def maybe(self, name: str) -> float | None:
        return self.number(name, 0.0) if name in self else None

    def whole(self, name: str, default: int) -> int:
        value = self.number(name, default)
        if value != int(value) or value < 0:
            raise InputError(f"{self.where}: {name} is not a whole number of at least 0")
        return int(value)

    def flag(self, name: str, default: bool) -> bool:
        value = self._values.get(name, default)
        if not isinstance(value, bool):
            raise InputError(f"{self.where}: {name} is neither true nor false")
        return value

    def texts(self, name: str) -> tuple[str, ...]:
        value = self._values.get(name, [])
        listed = [value] if isinstance(value, str) else value
        if not isinstance(listed, list) or not all(isinstance(text, str) for text in listed):
            raise InputError(f"{self.where}: {name} is not a list of names")
        return tuple(listed)

    def array(self, name: str, *shape: int | None) -> Floats:
        try:
            array: NDArray[np.float64] = np.asarray(self._values.get(name), np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
        if not fits or not array.size or not np.isfinite(array).all():
            raise InputError(f"{self.where}: {name} is missing, or not an array of finite numbers of the right shape")
        return array

    def inner(self, name: str) -> "_ScenarioTable":
        return _ScenarioTable(self._values[name], f"{self.where}, {name}")


def _read_actor(facts: _ScenarioTable) -> ScenarioActor:
    mode = next(iter(facts.texts("mode")), "override")
    if mode not in ("override", "optimized"):
        hint = did_you_mean(mode, ("override", "optimized"))
        raise InputError(f"{facts.where}: mode {mode!r} is unknown; {hint}use override or optimized")
    uuids = facts.texts("uuids") or facts.texts("uuid")
    if not uuids:
        raise InputError(f"{facts.where} names no actor; give uuid or uuids")
    times = positions = None
    if mode == "override":
        times = facts.array("times", None)
        positions = facts.array("positions", len(times), 3)
        if len(times) < 2 or (np.diff(times) <= 0).any():
            raise InputError(f"{facts.where}: times must be two or more in ascending order")
    return ScenarioActor(
        mode="override" if mode == "override" else "optimized",
        uuids=uuids,
        drawn="uuids" in facts,
        is_target=facts.flag("is_target_actor", False),
        times=times,
        positions=positions,
        initial_yaw=facts.number("initial_yaw", 0.0),
        flipped=facts.texts("flip_uuids"),
        exclusive_group=next(iter(facts.texts("exclusive_group")), None),
        size=facts.array("dims", 3) if "dims" in facts else None,
        jitter=_read_jitter(facts.inner("jitter")) if "jitter" in facts else None,
    )


def _read_jitter(facts: _ScenarioTable) -> Jitter:
    return Jitter(
        longitudinal=facts.maybe("longitudinal"),
        lateral=facts.maybe("lateral"),
        angle=facts.maybe("long_lat_angle"),
        yaw=facts.maybe("yaw_jitter"),
        times=tuple(facts.array("times", None).tolist()) if "times" in facts else None,
        uniform=facts.flag("uniform", True),
    )
