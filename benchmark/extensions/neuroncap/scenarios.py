"""NeuroNCAP's scenarios as data: what is put in the way, and how much of it is drawn; its own, and those of files."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError, did_you_mean
from benchmark.geometry import Floats
from benchmark.untrusted.files import to_one_line
from benchmark.untrusted.text_files import read_json, read_yaml

OFFICIAL_FILE: Final = Path(__file__).parent / "assets" / "official_scenarios.json"
STEP_S: Final = 0.5
"""The only step that the engine takes."""
_FRAMERATE: Final = 2.0
"""Poses of an actor a second, as published code has them; the engine supports no other number."""
FAMILIES: Final = ("stationary", "frontal", "side")
_NO_ACTORS: Final = 1
"""Primed steps without a scenario."""
_MOST: Final = 1e6
"""Of any number, metres, seconds or radians: no map is as large."""
_LONGEST_S: Final = 600.0
_MOST_FRAMES: Final = 10_000
_MOST_ACTORS: Final = 200
_NOT_READ: Final = ("start_pose", "start_velo", "smooth_actors")
"""Of ``general``: neither the published code nor this engine reads them."""
_NAMES: Final[dict[str, tuple[str, ...]]] = {
    "scenario": ("general", "actors"),
    "general": (
        *("start_frame", "priming_steps", "time_step", "duration", "start_jitter", "dim_jitter", "actor_framerate"),
        *_NOT_READ,
    ),
    "actor": (
        *("mode", "uuid", "uuids", "is_target_actor", "times", "positions", "initial_yaw", "flip_uuids", "dims"),
        *("exclusive_group", "jitter"),
    ),
    "jitter": ("longitudinal", "lateral", "long_lat_angle", "yaw_jitter", "times", "uniform"),
}
"""What a file may name, by the table that it stands in."""


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
        step, rate = general.number("time_step", STEP_S), general.number("actor_framerate", _FRAMERATE)
        if step != STEP_S:
            raise InputError(f"{where} sets steps of {step} s; this engine supports {STEP_S} s")
        if rate != _FRAMERATE:
            raise InputError(f"{where} sets an actor_framerate of {rate}; this engine supports {_FRAMERATE}")
        actors = facts.get("actors") or []
        if not isinstance(actors, list) or len(actors) > _MOST_ACTORS:
            raise InputError(f"{where}: actors is not a list of at most {_MOST_ACTORS}")
        listed = tuple(
            _read_actor(_ScenarioTable(actor_value, f"{where}, actor {number}"))
            for number, actor_value in enumerate(actors)
        )
        if sum(actor.is_target for actor in listed) > 1:
            raise InputError(f"{where} has more than one target actor; leave one")
        return cls(
            start_frame=general.whole("start_frame", 0),
            priming_steps=general.whole("priming_steps", _NO_ACTORS),
            duration_s=general.number("duration", 20.0, least=STEP_S, most=_LONGEST_S),
            start_jitter=general.whole("start_jitter", 0),
            dim_jitter=general.number("dim_jitter", 0.0, least=0.0, most=0.9),
            actors=listed,
        )

    @property
    def draws(self) -> bool:
        """Whether two runs of it can differ."""
        choices = len(self.actors) > 1 or any(len(actor.uuids) > 1 for actor in self.actors)
        return bool(self.start_jitter or self.dim_jitter or choices or any(actor.jitter for actor in self.actors))


@dataclass(frozen=True, slots=True)
class ScenarioFile:
    """A scenario of a file; `content` is what it says, under names with ``_``, as a record keeps it.

    `name` is the file's, with its folder where that is one of `FAMILIES`, which then is the `family`, else empty.
    """

    name: str
    content: Mapping[str, Any]
    scenario: Scenario

    @classmethod
    def of(cls, name: str, content: Any) -> Self:
        """From a name and content as in a record; `InputError` for no scenario, or one without actors."""
        scenario = Scenario.of(_require_mapping(content, name), name)
        if not scenario.actors:
            raise InputError(f"{name} lists no actors; give at least one, or drive scenes as they are")
        return cls(name, content, scenario)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a YAML file as NeuroNCAP has it; unlike there, names that nothing reads are refused."""
        content = _sanitise_names(read_yaml(path), "scenario", str(path))
        family = path.absolute().parent.name
        name = to_one_line(f"{family}/{path.name}" if family in FAMILIES else path.name, 80)
        return cls(name, content, cls.of(str(path), content).scenario)

    @property
    def family(self) -> str:
        """The folder that it was read from, if that is a family."""
        folder, slash, _ = self.name.partition("/")
        return folder if slash and folder in FAMILIES else ""

    @property
    def uuids(self) -> frozenset[str]:
        """All instances that it may put on stage."""
        return frozenset(uuid for actor in self.scenario.actors for uuid in actor.uuids)


def _sanitise_names(value: Any, table: str, where: str) -> dict[str, Any]:
    """A table of a file under names with ``_``, without what nothing reads; unknown names are refused."""
    known = _NAMES[table]
    named: dict[str, Any] = {}
    for name, member in _require_mapping(value, where).items():
        plain = to_one_line(name, 40).replace("-", "_")
        if plain not in known:
            hint = did_you_mean(plain, known)
            raise InputError(
                f"{where} names {plain!r}, which NeuroNCAP does not read; {hint}correct it or leave it out"
            )
        if plain in ("general", "jitter") and member is not None:
            named[plain] = _sanitise_names(member, plain, f"{where}, {plain}")
        elif plain == "actors" and isinstance(member, list):
            named[plain] = [_sanitise_names(one, "actor", f"{where}, actor {i}") for i, one in enumerate(member)]
        elif plain not in _NOT_READ:
            named[plain] = member
    return named


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

    def number(self, name: str, default: float, *, least: float = -_MOST, most: float = _MOST) -> float:
        value = self._values.get(name, default)
        if not _is_number(value):
            raise InputError(f"{self.where}: {name} is not a finite number")
        if not least <= value <= most:
            raise InputError(f"{self.where}: {name} is not a number from {least:g} to {most:g}")
        return float(value)

    def maybe(self, name: str, *, least: float = 0.0) -> float | None:
        return self.number(name, 0.0, least=least) if name in self else None

    def whole(self, name: str, default: int) -> int:
        value = self.number(name, default)
        if value != int(value) or not 0 <= value <= _MOST_FRAMES:
            raise InputError(f"{self.where}: {name} is not a whole number of at least 0 and at most {_MOST_FRAMES}")
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
        value = self._values.get(name)
        try:
            array: NDArray[np.float64] = np.asarray(value if _are_numbers(value) else (), np.float64)
        except ValueError:
            array = np.empty(0)
        fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
        if not fits or not array.size or np.abs(array).max() > _MOST:
            raise InputError(f"{self.where}: {name} is missing, or not an array of finite numbers of the right shape")
        return array

    def label(self, name: str) -> str | None:
        value = self._values.get(name)
        if isinstance(value, int) and not isinstance(value, bool):
            return str(value) if value else None
        return next(iter(self.texts(name)), None) or None

    def size(self, name: str) -> Floats:
        size = self.array(name, 3)
        if not (size > 0.0).all():
            raise InputError(f"{self.where}: {name} is not width, length and height above 0")
        return size

    def inner(self, name: str) -> "_ScenarioTable":
        return _ScenarioTable(self._values[name], f"{self.where}, {name}")


def _is_number(value: Any) -> bool:
    """Whether a value is a finite number, of which truth values are none."""
    return type(value) is int or (type(value) is float and math.isfinite(value))


def _are_numbers(value: Any) -> bool:
    return all(map(_are_numbers, value)) if isinstance(value, list) else _is_number(value) and abs(value) <= 2 * _MOST


def _read_actor(facts: _ScenarioTable) -> ScenarioActor:
    mode = to_one_line(next(iter(facts.texts("mode")), "override"), 40)
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
        exclusive_group=facts.label("exclusive_group"),
        size=facts.size("dims") if "dims" in facts else None,
        jitter=_read_jitter(facts.inner("jitter")) if "jitter" in facts else None,
    )


def _read_jitter(facts: _ScenarioTable) -> Jitter:
    return Jitter(
        longitudinal=facts.maybe("longitudinal"),
        lateral=facts.maybe("lateral"),
        angle=facts.maybe("long_lat_angle", least=-_MOST),
        yaw=facts.maybe("yaw_jitter"),
        times=tuple(facts.array("times", None).tolist()) if "times" in facts else None,
        uniform=facts.flag("uniform", True),
    )
