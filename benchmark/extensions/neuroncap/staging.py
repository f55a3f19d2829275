"""A scenario on stage: start and actors of a run, whose draws, in the official order, are seeded by the run's index."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.actors import Actor, Integers, interpolate_pose
from benchmark.extensions.neuroncap.scenarios import STEP_S, Scenario, ScenarioActor
from benchmark.geometry import Floats
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches

Draw = tuple[Any, ...]
"""Name of the generator's call, its arguments, its result; permutations and choices as indices."""


class LoggedGenerator:
    """PCG64 with a log of all draws in order."""

    def __init__(self, seed: int, made: Sequence[Draw] = ()) -> None:
        self._generator = np.random.default_rng(seed)
        self.made: list[Draw] = [*made, ("default_rng", seed)]

    def reseed(self, seed: int) -> Self:
        """A fresh generator whose log goes on from this one's."""
        return type(self)(seed, self.made)

    def integers(self, low: int, high: int) -> int:
        """From ``low`` to ``high - 1``."""
        drawn = int(self._generator.integers(low, high))
        self.made.append(("integers", low, high, drawn))
        return drawn

    def permutation(self, count: int) -> list[int]:
        """An order of so many."""
        drawn = [int(index) for index in self._generator.permutation(count)]
        self.made.append(("permutation", count, drawn))
        return drawn

    def choice(self, count: int) -> int:
        """One of so many; no bits are used for one."""
        drawn = int(self._generator.choice(count))
        self.made.append(("choice", count, drawn))
        return drawn

    def uniform(self, limit: float) -> float:
        """Between plus and minus a limit."""
        drawn = float(self._generator.uniform(-limit, limit))
        self.made.append(("uniform", -limit, limit, drawn))
        return drawn

    def normal(self, scale: float) -> float:
        """Around zero with a standard deviation."""
        drawn = float(self._generator.normal(scale=scale))
        self.made.append(("normal", scale, drawn))
        return drawn


_UP: Final = np.array([0.0, 0.0, 1.0])
_NO_TIME_S: Final = 1e-6


@dataclass(frozen=True, slots=True)
class RenderableActors:
    """Road users that the renderer can show, by instance token, with tracks that ``optimized`` scenarios ask for.

    Sizes are (3,) width, length, height, metres, in single precision as renderers have them.
    """

    kinds: Mapping[str, str]
    sizes: Mapping[str, Floats]
    tracks: Mapping[str, Actor]

    @classmethod
    def of(cls, actors: Iterable[Actor]) -> Self:
        """A renderer that was made from a recording: it shows all its actors, in single precision like NeuRAD."""
        tracks = {actor.uuid: _to_single_precision(actor) for actor in actors}
        kinds = {uuid: track.kind for uuid, track in tracks.items()}
        return cls(kinds, {uuid: track.size for uuid, track in tracks.items()}, tracks)


def _to_single_precision(actor: Actor) -> Actor:
    size, poses = (np.asarray(values.astype(np.float32), np.float64) for values in (actor.size, actor.poses))
    return replace(actor, size=size, poses=poses)


@dataclass(frozen=True, slots=True)
class StagedRun:
    """One run of a scenario, with its actors in the order drawn; `dim_scale` is a factor on sizes.

    `sizes` are the renderer's as the next run finds them.
    """

    start_frame: int
    end_us: int
    actors: tuple[Actor, ...]
    draws: tuple[Draw, ...]
    dim_scale: float | None
    sizes: Mapping[str, Floats]


def stage_run(
    scenario: Scenario,
    run: int,
    times: Integers,
    cast: RenderableActors,
    switches: NeuroncapSwitches,
    *,
    jitter: bool = True,
) -> StagedRun:
    """Set up one run, whose index is the seed; ``times`` are (F,) microseconds of the recording's frames.

    Without ``jitter`` actors are not moved or shuffled; draws of actors and start are made all the same.
    """
    draws, start = None, scenario.start_frame
    if scenario.start_jitter:
        draws = LoggedGenerator(run)
        start = max(0, start + draws.integers(-scenario.start_jitter, scenario.start_jitter + 1))
    if start + scenario.priming_steps >= len(times) or scenario.start_frame >= len(times):
        raise InputError(
            f"a run from frame {start} with {scenario.priming_steps} primed steps needs more than the {len(times)} "
            "frames of this recording"
        )
    end = int(times[start]) + int(scenario.duration_s * 1e6)
    if not scenario.actors:
        return StagedRun(start, end, (), tuple(draws.made if draws else ()), None, cast.sizes)
    if draws is None or switches.start_jitter_stream == "code":
        draws = draws.reseed(run) if draws else LoggedGenerator(run)
    scale = 1.0 + draws.uniform(scenario.dim_jitter) if scenario.dim_jitter and jitter else None
    stage = _RunSetup(times, cast, _compute_pose_times(scenario, start, times, switches), scale, jitter, switches)
    order = draws.permutation(len(scenario.actors)) if jitter else range(len(scenario.actors))
    actors, groups = [], set()
    for index in order:
        scenario_actor = scenario.actors[index]
        if scenario_actor.exclusive_group is not None:
            if scenario_actor.exclusive_group in groups:
                continue
            groups.add(scenario_actor.exclusive_group)
        actors.append(_place_actor(scenario_actor, draws, stage))
    # The published code scales the renderer's sizes in place, so they grow from run to run.
    scaled = {actor.uuid: actor.size for actor in actors} if scale and switches.dims_jitter == "code" else {}
    own = {
        uuid for scenario_actor in scenario.actors if scenario_actor.size is not None for uuid in scenario_actor.uuids
    }
    renderer_sizes = {uuid: size for uuid, size in scaled.items() if uuid not in own}
    return StagedRun(start, end, tuple(actors), tuple(draws.made), scale, {**cast.sizes, **renderer_sizes})


@dataclass(frozen=True, slots=True)
class _RunSetup:
    """Shared facts of all actors of a run: frames, actors that exist, when they have poses, and how they are drawn."""

    times: Integers
    cast: RenderableActors
    seconds: Floats
    scale: float | None
    jitter: bool
    switches: NeuroncapSwitches


def _compute_pose_times(scenario: Scenario, start: int, times: Integers, switches: NeuroncapSwitches) -> Floats:
    """Seconds since the first frame at which actors have poses."""
    if switches.time_step_of_actors == "code":
        since_start = np.linspace(0.0, scenario.duration_s, int(2 * scenario.duration_s))
    else:
        since_start = STEP_S * np.arange(int(scenario.duration_s / STEP_S) + 1)
    first = scenario.start_frame if switches.actor_window == "code" else start
    return np.asarray(since_start + (int(times[first]) - int(times[0])) / 1e6)


def _place_actor(actor: ScenarioActor, draws: LoggedGenerator, stage: _RunSetup) -> Actor:
    uuid, cast = actor.uuids[draws.choice(len(actor.uuids)) if actor.drawn else 0], stage.cast
    if uuid not in cast.kinds or uuid not in cast.sizes:
        raise InputError(f"the scenario names {uuid}, which is not an instance of this recording")
    size = np.asarray(cast.sizes[uuid] if actor.size is None else actor.size, np.float64)
    if stage.scale is not None:
        size = np.asarray(size.astype(np.float32) * np.float32(stage.scale), np.float64)
    if actor.mode == "optimized":
        if uuid not in cast.tracks:
            raise InputError(f"the scenario needs the renderer's track of {uuid}, which does not exist")
        poses = _sample_recorded_poses(cast.tracks[uuid], stage.seconds, int(stage.times[0]))
    else:
        poses = _draw_poses(actor, uuid, float(size[2]), draws, stage)
    # Truncated, so that stamps end in ...599999.
    stamps = np.trunc(stage.seconds * 1e6).astype(np.int64) + int(stage.times[0])
    return Actor(uuid, cast.kinds[uuid], size, stamps, poses, actor.is_target)


def _draw_poses(actor: ScenarioActor, uuid: str, height: float, draws: LoggedGenerator, stage: _RunSetup) -> Floats:
    """(T, 4, 4) poses of the scenario's own track, moved as drawn; the order of the draws is the official one."""
    assert actor.times is not None and actor.positions is not None
    positions, times, yaw = actor.positions.copy(), actor.times, actor.initial_yaw
    jitter = actor.jitter if stage.jitter else None
    if jitter is not None:
        draw = draws.uniform if jitter.uniform else draws.normal
        if jitter.angle is not None:
            cos, sin = np.cos(jitter.angle), np.sin(jitter.angle)
            if jitter.longitudinal is not None:
                positions[:, :2] += draw(jitter.longitudinal) * np.array([cos, sin])
            if jitter.lateral is not None:
                positions[:, :2] += draw(jitter.lateral) * np.array([sin, -cos])
        if jitter.yaw is not None:
            yaw += draw(jitter.yaw)
        if jitter.times is not None and stage.switches.jitter_times == "paper":
            moved = [draw(limit) if limit else 0.0 for limit in jitter.times[: len(times)]]
            times = times + np.pad(moved, (0, len(times) - len(moved)))
    if uuid in actor.flipped:
        yaw += np.pi
    positions[:, 2] += 0.5 * height
    return _orient_along_path(_interpolate_positions(times, positions, stage.seconds), yaw)


def _interpolate_positions(times: Floats, positions: Floats, seconds: Floats) -> Floats:
    """(T, 3) piecewise linear positions that go on beyond the ends as they came."""
    piece = np.clip(np.searchsorted(times, seconds) - 1, 0, len(times) - 2)
    slope = (positions[piece + 1] - positions[piece]) / (times[piece + 1] - times[piece])[:, None]
    return np.asarray(positions[piece] + (seconds - times[piece])[:, None] * slope)


def _orient_along_path(positions: Floats, yaw: float) -> Floats:
    """(T, 4, 4) poses that look along their next step, the last as the one before; with a heading where they stand."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 3] = positions
    steps = np.diff(positions, axis=0)
    for index, step in enumerate(steps):
        poses[index, :3, :3] = _orient_along_step(step, yaw)
    if len(poses) > 1:
        poses[-1, :3, :3] = poses[-2, :3, :3]
    return poses


def _orient_along_step(step: Floats, yaw: float) -> Floats:
    length = float(np.linalg.norm(step))
    forward = step / length if length > 0 else _UP
    left = np.cross(_UP, forward)
    if not np.linalg.norm(left) > 0:
        return np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    left = left / np.linalg.norm(left)
    return np.column_stack([forward, left, np.cross(forward, left)])


def _sample_recorded_poses(track: Actor, seconds: Floats, first_us: int) -> Floats:
    """(T, 4, 4) the renderer's own track; beyond its ends the nearest pose stays."""
    known = (track.times - first_us) / 1e6
    right = np.searchsorted(known, seconds)
    left, right = np.clip(right - 1, 0, len(known) - 1), np.clip(right, 0, len(known) - 1)
    fraction = (seconds - known[left]) / (known[right] - known[left] + _NO_TIME_S)
    fraction = np.where(left == right, 0.0, fraction)
    return np.array(
        [interpolate_pose(track.poses[a], track.poses[b], float(f)) for a, b, f in zip(left, right, fraction)]
    )
