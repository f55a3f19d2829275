"""What stands behind ``drive``: engines and agents of `benchmark`, cameras of `generation`, planners of `adapters`."""

from typing import TYPE_CHECKING

from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmark.closed_loop.drives.sensors import Sensor
    from benchmark.machine.workers import Executor
    from benchmark.runs.driving import DriveSettings


def looks_at_images(name: str) -> bool | None:
    """Whether a planner looks at images: built-in ones say so, HTTP carries some, of others nobody knows (``None``)."""
    from adapters.models import MODELS
    from benchmark.closed_loop.wire.address import is_address

    if is_address(name):
        return True
    return not MODELS[name].blind if name in MODELS else None


def drive_settings(
    split: str,
    *,
    engine: str = "default",
    agents: str = "replay",
    sensor: str = "none",
    accept_torch_tensors: bool = False,
    latency_ms: int = 0,
    scenarios: str = "recorded",
    runs: int = 1,
    scenes: "Sequence[str] | None" = None,
    limit: int | None = None,
    executor: "Executor | None" = None,
    timeout_s: float = 120.0,
    seed: int = 0,
) -> "DriveSettings":
    """How planners are driven, for `benchmark.drive_split` (docs/closed-loop.md).

    Args:
        split: The split; generated ones have pictures in a style of their own.
        engine: ``default``, ``neuroncap@code`` or ``neuroncap@paper``, with departures as its switches are named.
        agents: ``replay`` or ``idm``; NeuroNCAP's never react.
        sensor: ``none``, ``schematic``, or the address of a renderer's server (docs/model-servers.md).
        accept_torch_tensors: Whether a renderer's pictures may be saved tensors, which are pickles.
        latency_ms: So much later does a plan take effect; a multiple of 100, 0 in NeuroNCAP's engine.
        scenarios: In NeuroNCAP's engine: scenes as they are (``recorded``), with ``own`` or ``official`` scenarios.
        runs: Runs of each scene; one where nothing is drawn.
        scenes: Only these scenes.
        limit: Only the first so many.
        executor: Where drives are made; this process by default.
        timeout_s: How long a plan may take.
        seed: Of the intervals.

    Returns:
        The settings.

    Raises:
        InputError: If there is no such engine, policy or sensor, or they do not go together.
    """
    from benchmark.closed_loop.engines import rides_of
    from benchmark.machine.workers import LocalProcesses
    from benchmark.runs.driving import DriveSettings

    return DriveSettings(
        engine=engine,
        maker=rides_of(engine, agents, latency_ms, scenarios),
        agents=agents,
        sensor=_sensor(sensor, split, tensors=accept_torch_tensors),
        runs=runs,
        latency_ms=latency_ms,
        scenarios=scenarios,
        scenes=None if scenes is None else tuple(scenes),
        limit=limit,
        executor=executor or LocalProcesses(),
        timeout_s=timeout_s,
        seed=seed,
    )


def require_sensor(sensor: str) -> None:
    """Raise `InputError` for what names no sensor; nobody is asked whether a server answers."""
    from benchmark.closed_loop.drives.sensors import NO_SENSOR
    from benchmark.closed_loop.wire.address import Address, is_address

    known = (NO_SENSOR, "schematic")
    if is_address(sensor):
        if Address.of(sensor, "--sensor").name in known:
            raise InputError(f"--sensor {sensor} is called like a sensor that there is; give it another name")
    elif sensor not in known:
        raise InputError(
            f"there is no sensor {sensor!r}; {did_you_mean(sensor, known)}there are {' and '.join(known)}, and "
            "renderers at http://HOST:PORT"
        )


def _sensor(name: str, split: str, *, tensors: bool) -> "Sensor":
    from benchmark.closed_loop.drives.sensors import NO_SENSOR, NoSensor
    from benchmark.closed_loop.wire.address import Address, is_address
    from benchmark.closed_loop.wire.sensor import HttpSensor
    from benchmark.machine.workspace import is_generated
    from generation.render.sensor import SchematicSensor

    require_sensor(name)
    if is_address(name):
        return HttpSensor(Address.of(name, "--sensor"), tensors)
    # Generated splits are drawn in the second style, what they are made from in the first.
    return NoSensor() if name == NO_SENSOR else SchematicSensor("second" if is_generated(split) else "first")
