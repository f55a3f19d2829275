"""Estimates, for people alone, of how long a build takes and where its time goes, from notes or small samples."""

import functools
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from benchmark.geometry import Floats
from benchmark.machine.storage import read_cached_json
from benchmark.machine.workers import Executor, LocalProcesses, single_threaded
from benchmark.published import RUNTIME_S
from benchmark.records.statistics import BuildRuntime
from benchmark.report.table import Table, build_table
from benchmark.report.words import pluralise
from benchmark.scene import Scene
from generation.render.contract import Renderer, SlowRenderer
from generation.search.candidates import find_launch_frame
from generation.search.definition import Search, SearchUnit
from generation.search.planning import AdversaryPlanning
from generation.search.proposals import MutationRequest, SamplingRequest

STAGES: Final = ("sampling", "physics", "scoring", "rendering", "other")


class _StageTimes(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    seconds: dict[str, float]


class RuntimeTable(BuildRuntime):
    """Processor seconds of a build, for people."""

    def table(self) -> Table:
        """The same for a terminal, the paper's beside it."""
        rows = [(stage, self.total_s[stage], self.each_s(stage), RUNTIME_S.get(stage)) for stage in STAGES]
        ours = sum(self.each_s(stage) or 0.0 for stage in STAGES)
        rows.append(("all", sum(self.total_s.values()), ours, sum(RUNTIME_S.values())))
        return build_table(
            "runtime",
            f"processor seconds of {pluralise(self.attempts, 'attempt')} and {pluralise(self.scenes, 'scene')}",
            ("stage", "total", "each", "paper"),
            [(name, *("-" if value is None else f"{value:.2f}" for value in seconds)) for name, *seconds in rows],
            notes=(
                "each: one attempt, rendering one scene; paper: quoted, seconds by the clock for one scene on two Xeon "
                "8457C and four L20, rendered by MagicDriveDiT.",
            ),
        )


def build_runtime_table(attempts: Iterable[Path], scenes: Iterable[Path]) -> RuntimeTable:
    """Table of the time that notes of attempts and of rendered scenes add up to; damaged and absent ones count 0."""
    of_attempts, of_scenes = _read_stage_times(attempts), _read_stage_times(scenes)
    total = dict.fromkeys(STAGES, 0.0)
    for note in (*of_attempts, *of_scenes):
        for stage, seconds in note.seconds.items():
            total[stage if stage in total else "other"] += seconds
    return RuntimeTable(attempts=len(of_attempts), scenes=len(of_scenes), total_s=total)


def read_runtime_table(state: Path, timings: Path) -> RuntimeTable | None:
    """Table of the time that a build took, of all attempts timed there and the scenes that are written now, if any."""
    attempts = sorted((timings / "attempts").glob("*.timing.json"))
    written = sorted((state / "fragments").glob("*.json"))
    runtime = build_runtime_table(attempts, [timings / "rendering" / f"{path.stem}.timing.json" for path in written])
    return runtime if runtime.attempts or runtime.scenes else None


def compute_mean_seconds(notes: Sequence[Path]) -> float | None:
    """Mean over notes of all stages together, ``None`` where there is no note."""
    stage_times = _read_stage_times(notes)
    return sum(sum(note.seconds.values()) for note in stage_times) / len(stage_times) if stage_times else None


def _read_stage_times(paths: Iterable[Path]) -> list[_StageTimes]:
    stage_times = []
    for path in paths:
        try:
            stage_times.append(_StageTimes.model_validate(read_cached_json(path)))
        except ValidationError:
            # Times are a convenience; a damaged or absent note is ignored.
            continue
    return stage_times


KEPT_SHARE = 0.4
"""Share of attempts that is expected to pass verification while none has been made: about that of the town."""
_PREVIOUS = np.array([-4.0, 0.0, 0.0])
"""Pose half a second ago at 8 m/s: any will do to see how long an answer takes."""


@dataclass(frozen=True, slots=True)
class WorkEstimate:
    """Amount of work, and about how long it takes.

    ``attempts`` are left, with those of later adversaries; ``scenes`` to render are at most or expected; ``workers``
    share the planning, ``None`` where their number is not known.
    """

    attempts: int
    attempt_s: float
    scenes: int
    scene_s: float
    workers: int | None
    renderers: int | None

    def sentence(self) -> str:
        """For people."""
        parts = []
        for work, unit, count, unit_s, workers in (
            ("planning", "attempt", self.attempts, self.attempt_s, self.workers),
            ("rendering", "scene", self.scenes, self.scene_s, self.renderers),
        ):
            if count and unit_s:
                time_left = format_duration(count * unit_s / (workers or 1))
                parts.append(
                    (
                        f"{time_left} of {work} ({pluralise(count, unit)} at {format_duration(unit_s)})",
                        _format_workers(workers),
                    )
                )
        if not parts:
            return "about no time"
        if self.workers == self.renderers:
            return f"about {' and '.join(part for part, _ in parts)} {parts[0][1]}"
        return f"about {' and '.join(f'{part} {on}' for part, on in parts)}"


def _format_workers(workers: int | None) -> str:
    return "in all" if workers is None else f"on {workers} worker{'' if workers == 1 else 's'}"


def format_duration(seconds: float) -> str:
    """Seconds as people say them: 0.4 s, 35 s, 12 min, 3.5 h."""
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.{1 if seconds < 10 * size else 0}f} {unit}"
    return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"


def estimate_planning(
    search: Search,
    units: Sequence[SearchUnit],
    left: Sequence[SearchUnit],
    read: Callable[[str], Scene],
    adversaries: int,
) -> tuple[int, float]:
    """Attempts that are left, and processor seconds of one of them.

    Each kept adversary begins a chain that tries about as many vehicles again, up to ``adversaries`` in each scene.
    """
    if not units:
        return 0, 0.0
    scenes = len({unit.scene_name for unit in units})
    later = (adversaries - 1) * KEPT_SHARE * len(units) * max(len(units) / scenes - 1.0, 0.0)
    count = len(left) + round(later)
    known = compute_mean_seconds([search.timing_path(search.key(unit)) for unit in units])
    if known is not None or not count:
        return count, known or 0.0
    unit = left[0] if left else units[0]
    return count, measure_attempt_seconds(search, read(unit.scene_name), unit)


def measure_attempt_seconds(search: Search, scene: Scene, unit: SearchUnit) -> float:
    """Processor seconds of one attempt: one network call of each kind and one evaluation, times how often they happen.

    A second try doubles them, giving up early shortens them.
    """
    single_threaded()
    hyper, prior = search.hyper, search.prior()
    start = find_launch_frame(scene, unit.agent, hyper)
    if start is None:
        return 0.0
    rng, stages = np.random.default_rng(0), {"physics": 0.0, "scoring": 0.0}
    planning = AdversaryPlanning(scene, unit.agent, start, hyper, _keep_unchanged, hyper.motion_model(), rng, stages)
    evaluation = planning.build_evaluation(start, planning.compute_first_state(), planning.find_first_pose()[None])
    waypoints = prior.answer([SamplingRequest(hyper.candidates, _PREVIOUS, rng)])[0]

    def evaluate() -> None:
        evaluation(waypoints)

    refinements = len(hyper.noise_levels())
    sampling = _measure_seconds(lambda: prior.answer([SamplingRequest(hyper.candidates, _PREVIOUS, rng)]))
    mutation = 0.0
    if refinements:
        level = hyper.noise_levels()[0]
        mutation = _measure_seconds(lambda: prior.answer([MutationRequest(waypoints, level, _PREVIOUS, rng)]))
    frames = math.ceil((len(scene.timestamps_us) - 1 - start) / hyper.executed_frames)
    return frames * (sampling + refinements * mutation + (refinements + 1) * _measure_seconds(evaluate))


def _keep_unchanged(waypoints: Floats, rng: np.random.Generator) -> Floats:
    return waypoints


def estimate_rendering(
    renderer: Renderer | None, scene: Scene, frames: Literal["all", "keyframes"], timing: Path
) -> float:
    """Processor seconds of rendering one scene, 0 without a renderer; one that takes long says it itself."""
    if renderer is None:
        return 0.0
    if isinstance(renderer, SlowRenderer):
        return renderer.scene_seconds(scene)
    single_threaded()
    count = len(scene.timestamps_us) if frames == "all" else len(scene.keyframes)
    known = compute_mean_seconds(sorted(timing.glob("*.timing.json"))[:100])
    if known is not None:
        return known
    few = [int(frame) for frame in scene.keyframes[:4]]
    one, some = (_measure_seconds(functools.partial(_draw, renderer, scene, frames)) for frames in (few[:1], few))
    # The cost of a scene before its first picture is not paid again for each picture.
    frame_s = (some - one) / (len(few) - 1) if len(few) > 1 else one
    return one + max(frame_s, 0.0) * (count - 1)


def _draw(renderer: Renderer, scene: Scene, frames: Sequence[int]) -> None:
    for _ in renderer.render(scene, frames):
        pass


def count_workers(executor: Executor) -> int | None:
    """Number of processes of an executor, where that is known."""
    return executor.workers if isinstance(executor, LocalProcesses) else None


def _measure_seconds(work: Callable[[], object]) -> float:
    """Processor seconds of a piece of work, after a first time that does not count."""
    work()
    start = time.process_time()
    work()
    return time.process_time() - start
