"""What stands behind ``drive``: engines and agents of `benchmark`, cameras of `generation`, planners of `adapters`."""

from typing import TYPE_CHECKING

from benchmark.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmark.machine.workers import Executor
    from benchmark.runs.driving import DriveSettings


def looks_at_images(name: str) -> bool | None:
    """Whether a planner looks at images: built-in ones say so, of others nobody knows (``None``)."""
    from adapters.models import MODELS

    return not MODELS[name].blind if name in MODELS else None


def drive_settings(
    split: str,
    *,
    engine: str = "default",
    agents: str = "replay",
    sensor: str = "none",
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
        sensor: ``none`` or ``schematic``.
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
    from benchmark.closed_loop.drives.sensors import NO_SENSOR, NoSensor
    from benchmark.closed_loop.engines import rides_of
    from benchmark.machine.workers import LocalProcesses
    from benchmark.machine.workspace import is_generated
    from benchmark.runs.driving import DriveSettings
    from generation.render.sensor import SCHEMATIC, SchematicSensor

    if sensor not in (NO_SENSOR, SCHEMATIC):
        raise InputError(f"there is no sensor {sensor!r}; there are {NO_SENSOR} and {SCHEMATIC}")
    # Generated splits are drawn in the second style, what they are made from in the first.
    style = "second" if is_generated(split) else "first"
    return DriveSettings(
        engine=engine,
        maker=rides_of(engine, agents, latency_ms, scenarios),
        agents=agents,
        sensor=NoSensor() if sensor == NO_SENSOR else SchematicSensor(style),
        runs=runs,
        latency_ms=latency_ms,
        scenarios=scenarios,
        scenes=None if scenes is None else tuple(scenes),
        limit=limit,
        executor=executor or LocalProcesses(),
        timeout_s=timeout_s,
        seed=seed,
    )
