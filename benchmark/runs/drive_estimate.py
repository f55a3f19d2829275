"""How long driving a split would take: a few instants of one scene are driven, and nothing is kept."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from benchmark.closed_loop.episodes import EpisodeSpec, run_episode
from benchmark.machine.progress import format_duration
from benchmark.machine.workers import LocalProcesses
from benchmark.report.words import pluralise
from benchmark.runs.driving import DriveSettings, count_cached_units, make_job
from benchmark.runs.plan_rows import PlannerFactory
from benchmark.runs.redriving import read_recorded_can

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

TICKS: Final = 4
"""Planning instants that are tried: two of them drive."""
_SCORING_S: Final = 0.5
"""Of a drive, about."""


def estimate_driving(data: "DataSet", split: str, planner: PlannerFactory, settings: DriveSettings, out: Path) -> str:
    """Sentence on how much there is to drive, and how long it takes at most: drives that end in a contact take less."""
    scenes = settings.chosen(data, split)
    units = settings.units(data, scenes)
    job = make_job(data, split, planner.facts, out, settings)
    cached_count = count_cached_units(job, units)
    left = len(units) - cached_count
    seconds = 0.0
    if left:
        scene = data.scene(units[0].scene)
        stage = EpisodeSpec(
            scene,
            read_recorded_can(data, scene.name),
            0,
            job.maker_of(units[0]),
            settings.sensor,
            settings.timeout_s,
            units[0].family,
        )
        ready, started = planner(), time.perf_counter()
        run_episode(replace(stage, most_plans=1), ready)
        begun = time.perf_counter()
        run_episode(replace(stage, most_plans=1 + TICKS), ready)
        first, several = begun - started, time.perf_counter() - begun
        a_tick = max(several - first, 0.0) / TICKS
        seconds = left * (first + a_tick * (len(scene.keyframes) - 1) + _SCORING_S)
    workers = settings.executor.workers if isinstance(settings.executor, LocalProcesses) else 1
    where = f"{pluralise(len(scenes), 'scene')} of {split}, {pluralise(settings.runs_made, 'run')} each"
    done = f", {cached_count} of them already kept" if cached_count else ""
    return (
        f"would drive {planner.facts.name} through {where} ({pluralise(len(units), 'drive')}{done}; engine "
        f"{settings.measured.world}, sensor {settings.sensor.name}): at most about "
        f"{format_duration(seconds / workers)} on {pluralise(workers, 'process', 'processes')}"
    )
