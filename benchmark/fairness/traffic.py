"""Traffic of a data set around its recorded ego: headways, own motion, road users, and what blind planners collide in.

Everything is measured at key frames, on tracks that are linear between the annotations (``docs/data.md``).
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Final, Self

import numpy as np

from benchmark.datasets.annotated_objects import find_labelled_keyframes
from benchmark.datasets.categories import CategoryNames
from benchmark.datasets.roots import DataSet, open_data
from benchmark.fairness.data_set_assessment import read_adversarial_scene
from benchmark.geometry import Bools, Floats, box_gap, boxes_overlap, wrap_angle
from benchmark.interactions.driver_simulation import find_visible
from benchmark.interactions.tracks import STEP_S, ContinuousTracks
from benchmark.machine.workers import LocalProcesses
from benchmark.metrics.places import PlaceKind, read_sample_contexts
from benchmark.metrics.rates import HORIZONS, SceneSums, append_average, compute_ratios_of_sums
from benchmark.pdm.definition import ACCELERATION
from benchmark.pdm.recorded_scene import estimate_motion
from benchmark.planning import Command, Observation, Plan, Planner, PrivilegedPlanner, SceneInfo
from benchmark.protocols import compute_published_values, find_protocol
from benchmark.records.statistics import PlannerTraffic, TrafficFigure, TrafficStatistics
from benchmark.runs.judging import mask_unknown
from benchmark.runs.plan_rows import FAILURES
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

HEADWAY_STEPS: Final = 40
"""Of 0.1 s, in which a headway is looked for."""
NEAR_M: Final = 30.0
"""From the ego's centre to the centre of a road user around it."""
STANDING_M_S: Final = 0.5
MOVING_M_S: Final = 1.0
"""Vehicles at least so fast drive somewhere: along, across or against the ego's way."""
PARKED_M: Final = 1.0
"""A vehicle that is never farther from where it was first annotated is parked; annotations jitter."""
CROSSING_RAD: Final = np.deg2rad(45.0)
ONCOMING_RAD: Final = np.deg2rad(135.0)
CURVE_REACH_S: Final = 0.5
SHORTEST_CURVE_M: Final = 1.0
"""Over less way no curvature is known."""
_SAMPLES_AT_ONCE: Final = 64
"""Bounds the memory of headways: 64 samples of 200 vehicles need 20 MB."""
MEDIANS: Final = ("leader_headway_s", "follower_headway_s")
"""Figures that are medians over samples; all others are means, or shares of one."""

COLUMNS: Final = ("collision", "l2")
_AT_END: Final = HORIZONS.index("3s")
DIGITS: Final = 6
"""Of figures: below them, processors differ."""

Values = tuple[Floats, Floats]
"""What each of K samples adds to numerator and denominator of a figure, (K,) each."""
MakePlanner = Callable[..., Planner]
"""Makes a planner of a name and a seed in any process: importable."""


@dataclass(frozen=True, slots=True)
class SceneTraffic:
    """Figures of a scene by name; of each planner numerators and denominators over all its seeds, (4,) by horizon."""

    figures: Mapping[str, Values]
    planners: Mapping[str, Mapping[str, Values]]


def measure_headways(tracks: ContinuousTracks, times: Floats) -> tuple[Floats, Floats]:
    """Least times until bodies meet that do not touch now, in steps of 0.1 s up to 4 s; infinite where none do.

    Args:
        tracks: Tracks of a scene; vehicles among its agents count.
        times: (K,) seconds.

    Returns:
        (K,) seconds until the ego, on its recorded path, overlaps the place where a vehicle stands now; and (K,)
        seconds until a vehicle overlaps the place where the ego stands now.
    """
    vehicles = tracks.only(_are_of(tracks, "vehicle."))
    batches = [times[first : first + _SAMPLES_AT_ONCE] for first in range(0, len(times), _SAMPLES_AT_ONCE)]
    leader, follower = zip(*(_measure_batch(vehicles, batch) for batch in batches))
    return np.concatenate(leader), np.concatenate(follower)


def _measure_batch(vehicles: ContinuousTracks, times: Floats) -> tuple[Floats, Floats]:
    later = times[:, None] + STEP_S * np.arange(1, HEADWAY_STEPS + 1)
    recorded = later <= vehicles.seconds[-1] + 1e-9
    ego_now, ego_later = vehicles.ego_at(times), vehicles.ego_at(later)
    now, present = vehicles.agents_at(times)
    then, there = vehicles.agents_at(later)
    apart = ~(present & boxes_overlap(ego_now, now))[..., None] & recorded
    leader = _find_first_overlap(ego_later[None], now[:, :, None], apart & present[..., None])
    return leader, _find_first_overlap(ego_now[None, :, None], then, apart & there)


def _find_first_overlap(first: Floats, second: Floats, counts: Bools) -> Floats:
    """(K,) seconds of the first of (N, K, 40) instants that count at which boxes, broadcast to them, overlap."""
    offset = first[..., :2] - second[..., :2]
    reach = 0.5 * (np.hypot(first[..., 2], first[..., 3]) + np.hypot(second[..., 2], second[..., 3]))
    near = np.nonzero(counts & (np.hypot(offset[..., 0], offset[..., 1]) <= reach + 1e-6))
    mine, theirs = (np.broadcast_to(boxes, (*counts.shape, 5))[near] for boxes in (first, second))
    hit = boxes_overlap(mine, theirs)
    seconds = np.full(counts.shape[1], np.inf)
    np.minimum.at(seconds, near[1][hit], STEP_S * (near[2][hit] + 1))
    return seconds


def measure_figures(scene: Scene, truths: Sequence[SampleTruth]) -> dict[str, Values]:
    """What each of the K samples of a scene of two frames or more adds to each figure."""
    times, tracks = scene.seconds[scene.keyframes], ContinuousTracks.of_scene(scene)
    labelled = find_labelled_keyframes(scene.annotations.valid.sum(axis=0))
    complete = np.array([truth.by_clock.complete for truth in truths], np.bool_)
    whole = complete & [truth.labelled for truth in truths]
    figures: dict[str, Values] = {}
    for name, seconds in zip(("leader", "follower"), measure_headways(tracks, times)):
        figures |= {f"{name}_within_{limit}_s": _share(seconds <= limit + 1e-9, whole) for limit in (1, 3)}
        figures[f"{name}_headway_s"] = _mean(seconds, whole & np.isfinite(seconds))
    turning = np.array([truth.by_clock.command is not Command.STRAIGHT for truth in truths], np.bool_)
    figures |= _measure_own_motion(scene, tracks, times) | {"turning": _share(turning, complete)}
    figures |= {name: (top, under * labelled) for name, (top, under) in _measure_around(tracks, times).items()}
    adversaries = np.isin(scene.agents.ids, scene.adversaries)
    if adversaries.any():
        boxes, present = tracks.only(adversaries).agents_at(times)
        gap = np.where(present, box_gap(tracks.ego_at(times), boxes), np.inf).min(axis=0)
        everywhere = np.ones(len(times), np.bool_)
        figures |= {f"adversary_within_{limit}_m": _share(gap <= limit, everywhere) for limit in (2, 5)}
    return figures


def _measure_own_motion(scene: Scene, tracks: ContinuousTracks, times: Floats) -> dict[str, Values]:
    contexts = read_sample_contexts(scene)
    speed = np.array([context.speed_m_s for context in contexts])
    acceleration = estimate_motion(scene.ego.pose, scene.seconds)[scene.keyframes, ACCELERATION]
    before, after = (
        tracks.ego_at(np.clip(times + reach, 0.0, tracks.seconds[-1])) for reach in (-CURVE_REACH_S, CURVE_REACH_S)
    )
    driven = np.hypot(*(after[:, :2] - before[:, :2]).T)
    curvature = np.abs(wrap_angle(after[:, 4] - before[:, 4])) / np.maximum(driven, SHORTEST_CURVE_M)
    places = [context.place for context in contexts]
    junction = np.isin(places, [PlaceKind.JUNCTION, PlaceKind.ROUNDABOUT])
    everywhere = np.ones(len(times), np.bool_)
    return {
        "speed_m_s": _mean(speed, everywhere),
        "acceleration_m_s2": _mean(np.abs(acceleration), everywhere),
        "curvature_1_m": _mean(curvature, driven >= SHORTEST_CURVE_M),
        "standing": _share(speed < STANDING_M_S, everywhere),
        "junction": _share(junction, ~np.isin(places, [PlaceKind.UNKNOWN])),
    }


def _measure_around(tracks: ContinuousTracks, times: Floats) -> dict[str, Values]:
    """Figures of the road users within 30 m."""
    users = tracks.only(_are_of(tracks, "vehicle.", "human."))
    vehicles = _are_of(users, "vehicle.")[:, None]
    (boxes, present), ego = users.agents_at(times), users.ego_at(times)
    near = present & (np.hypot(*np.moveaxis(boxes[..., :2] - ego[:, :2], -1, 0)) <= NEAR_M)
    velocity = users.velocities_at(times)
    turned = np.abs(wrap_angle(np.arctan2(velocity[..., 1], velocity[..., 0]) - ego[:, 4]))
    driving = near & vehicles & (np.hypot(velocity[..., 0], velocity[..., 1]) >= MOVING_M_S)
    parked = near & vehicles & _find_parked(users)[:, None]
    hidden = np.array(
        [_count_hidden(users, eye, *rest) for eye, *rest in zip(ego[:, :2], near.T, boxes.swapaxes(0, 1), present.T)]
    )
    everywhere = np.ones(len(times), np.bool_)
    return {
        "road_users": _mean(near.sum(axis=0), everywhere),
        "pedestrians": _mean((near & ~vehicles).sum(axis=0), everywhere),
        "parked": (parked.sum(axis=0).astype(np.float64), (near & vehicles).sum(axis=0).astype(np.float64)),
        "oncoming": _share((driving & (turned > ONCOMING_RAD)).any(axis=0), everywhere),
        "crossing": _share((driving & (turned > CROSSING_RAD) & (turned <= ONCOMING_RAD)).any(axis=0), everywhere),
        "hidden": (hidden.astype(np.float64), near.sum(axis=0).astype(np.float64)),
    }


def _are_of(tracks: ContinuousTracks, *kinds: str) -> Bools:
    """(N,) whose category begins so."""
    return np.array([name.startswith(kinds) for name in tracks.categories], np.bool_)


def _find_parked(tracks: ContinuousTracks) -> Bools:
    """(N,) who never moves while annotated."""
    first = tracks.agents[np.arange(len(tracks)), tracks.valid.argmax(axis=1), None, :2]
    away = np.hypot(*np.moveaxis(tracks.agents[..., :2] - first, -1, 0))
    return np.asarray((np.where(tracks.valid, away, 0.0) <= PARKED_M).all(axis=1))


def _count_hidden(users: ContinuousTracks, eye: Floats, near: Bools, boxes: Floats, present: Bools) -> int:
    agents = np.flatnonzero(near)
    eyes = np.broadcast_to(eye, (len(agents), 2))
    return int((~find_visible(eyes, agents, boxes, present, users.hides)).sum())


def _mean(values: Floats, counts: Bools) -> Values:
    return np.where(counts, values, 0.0), counts.astype(np.float64)


def _share(holds: Bools, counts: Bools) -> Values:
    return _mean(holds.astype(np.float64), counts)


def measure_scene(
    data: DataSet, recordings: DataSet | None, planners: Mapping[str, Sequence[Planner]], name: str
) -> SceneTraffic:
    """Figures of one scene, and the rates of planners, each with all of its seeds; nothing of a scene of one frame.

    ``recordings``, which its scenes were made from, tell the adversaries of a data set that does not name them.
    """
    scene = read_adversarial_scene(data, name, recordings)
    if len(scene.timestamps_us) < 2:
        return SceneTraffic({}, {})
    truths, observations = data.truth(name), list(data.observations(name))
    judged = {
        called: _judge(truths, [one for planner in seeds for one in _plan(scene, observations, planner)])
        for called, seeds in planners.items()
    }
    return SceneTraffic(measure_figures(scene, truths), judged)


def _judge(truths: Sequence[SampleTruth], planned: Sequence[tuple[int, Plan]]) -> dict[str, Values]:
    """Numerators and denominators of rates and displacements, as `benchmark.metrics.rates.rates` makes them."""
    told, definition = [truths[index] for index, _ in planned], find_protocol("exact")
    plans = np.array([plan.waypoints_in_lidar(truth.lidar_ahead_m) for (_, plan), truth in zip(planned, told)])
    outcomes = mask_unknown(definition.evaluate(told, plans), told, told=True)
    published, sums = compute_published_values(definition, outcomes), {}
    for column in COLUMNS:
        values = append_average(published[column])
        known = ~np.isnan(values) & outcomes.counted[:, None]
        sums[column] = np.where(known, values, 0.0).sum(axis=0), known.sum(axis=0).astype(np.float64)
    return sums


def _plan(scene: Scene, observations: Sequence[Observation], planner: Planner) -> list[tuple[int, Plan]]:
    """Numbers of the samples that a planner plans for, and plans of 3 s."""
    planned = []
    planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
    if isinstance(planner, PrivilegedPlanner):
        planner.reveal(scene)
    for index, observation in enumerate(observations):
        with contextlib.suppress(*FAILURES):
            planned.append((index, planner.plan(observation).judged))
    return planned


def measure_scenes(
    data: DataSet,
    names: Sequence[str],
    planners: Mapping[str, int],
    make: MakePlanner,
    *,
    workers: int = 1,
    recordings: DataSet | None = None,
) -> TrafficStatistics:
    """Measure the traffic of scenes of a data set.

    Args:
        data: The data set.
        names: Scenes of it.
        planners: Planners that need no images, and of each the number of seeds, from 0.
        make: Makes a planner of a name and a ``seed``, in any process: importable.
        workers: Number of processes; the result does not depend on it.
        recordings: What its scenes were made from, if at hand, for data sets that do not name their adversaries.

    Returns:
        The figures over all samples and by scene, and the planners' rates under ``exact``.

    Raises:
        InputError: If a scene is broken.
    """
    seeds = tuple(planners.items())
    if workers == 1 or len(names) < 2:
        work = partial(measure_scene, data, recordings, _build(make, seeds))
    else:
        base = None if recordings is None else _Place.of(recordings)
        work = partial(_measure_elsewhere, _Place.of(data), base, make, seeds)
    found = LocalProcesses(workers).map(work, names, total=len(names), label="measuring traffic")
    scenes = dict(zip(names, found, strict=True))
    known = {name: scene for name, scene in scenes.items() if scene.figures}
    figures = dict.fromkeys(figure for scene in known.values() for figure in scene.figures)
    return TrafficStatistics(
        figures={figure: _summarise_figure(figure, known) for figure in figures},
        planners={name: _summarise_planner(name, draws, known) for name, draws in seeds if known},
        not_measured=tuple(name for name in names if name not in known),
    )


def _summarise_figure(name: str, scenes: Mapping[str, SceneTraffic]) -> TrafficFigure:
    values = {scene: traffic.figures[name] for scene, traffic in scenes.items() if name in traffic.figures}
    top, under = (np.concatenate(parts) for parts in zip(*values.values()))
    return TrafficFigure(
        value=_compute_figure(name, top, under),
        samples=int(np.count_nonzero(under)),
        scenes={scene: _compute_figure(name, *of_scene) for scene, of_scene in values.items()},
    )


def _compute_figure(name: str, top: Floats, under: Floats) -> float | None:
    if not under.any():
        return None
    return round(float(np.median(top[under > 0]) if name in MEDIANS else top.sum() / under.sum()), DIGITS)


def _summarise_planner(name: str, draws: int, scenes: Mapping[str, SceneTraffic]) -> PlannerTraffic:
    columns = {}
    for column in COLUMNS:
        top, under = (np.array(part) for part in zip(*(scene.planners[name][column] for scene in scenes.values())))
        sums = SceneSums(tuple(scenes), top, under)
        columns[column] = dict(zip(HORIZONS, compute_ratios_of_sums(sums, seed=0)))
    hits = {scene: traffic.planners[name]["collision"] for scene, traffic in scenes.items()}
    at_end = {
        scene: float(top[_AT_END] / under[_AT_END]) if under[_AT_END] else None for scene, (top, under) in hits.items()
    }
    return PlannerTraffic(draws=draws, scenes=at_end, **columns)


@dataclass(frozen=True, slots=True)
class _Place:
    """What opens a data set again in a worker process."""

    root: Path
    version: str
    name: str
    categories: CategoryNames

    @classmethod
    def of(cls, data: DataSet) -> Self:
        return cls(data.root, data.version, data.name, data.categories)

    def open(self) -> DataSet:
        return open_data(self.root, version=self.version, name=self.name, categories=dict(self.categories))


_Seeds = tuple[tuple[str, int], ...]


def _build(make: MakePlanner, seeds: _Seeds) -> dict[str, list[Planner]]:
    return {name: [make(name, seed=seed) for seed in range(draws)] for name, draws in seeds}


@lru_cache(maxsize=1)
def _open_once(
    data: _Place, recordings: _Place | None, make: MakePlanner, seeds: _Seeds
) -> tuple[DataSet, DataSet | None, dict[str, list[Planner]]]:
    return data.open(), None if recordings is None else recordings.open(), _build(make, seeds)


def _measure_elsewhere(
    data: _Place, recordings: _Place | None, make: MakePlanner, seeds: _Seeds, name: str
) -> SceneTraffic:
    """`measure_scene` in a worker process."""
    return measure_scene(*_open_once(data, recordings, make, seeds), name)
