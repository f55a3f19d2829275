"""What is judged: plans by protocols, driving scores and severity; scenes by drivers, severity and realism.

Samples have the size of nuScenes' (30 objects, 6 steps), scenes are those of the embedded town. The slow versions draw
every raster and build every polygon, as the official code does; they judge a few samples.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.speed.case import Case
from benchmark.datasets.sample_truth import compute_truth
from benchmark.extensions.golden_sets.fault import BUILT_IN
from benchmark.extensions.golden_sets.fault.cases import LAYERS, FaultCase, read_cases
from benchmark.fairness.fault_roads import FaultRoads
from benchmark.fairness.fault_rules import attribute_fault
from benchmark.fairness.features import RoadEdge, extract_recorded_runs, extract_runs
from benchmark.fairness.plan_severity import measure_plan_severities
from benchmark.fairness.severity_series import measure_severity
from benchmark.fairness.split_assessment import measure_realism
from benchmark.fairness.validity import find_track_defects
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.interactions.solvability import SceneReferenceDrivers
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.pdm.plan_motion import plan_to_poses
from benchmark.pdm.plan_scoring import score_scene_plans
from benchmark.pdm.recorded_scene import RecordedScene
from benchmark.planning import Plan, PlanFrame
from benchmark.protocols import PROTOCOLS
from benchmark.scene import Annotations, Scene
from benchmark.truth import SampleTruth
from benchmark.verification.golden_sets import GoldenFolder
from generation.sources.town import build_town_scene
from tests.benchmark.pdm.cases import slow_objects
from tests.benchmark.pdm.slow_pdm import SlowSample, slow_progress, slow_verdict
from tests.benchmark.protocols import slow_further_protocols as further
from tests.benchmark.protocols import slow_protocols as slow

OFFICIAL_S_PER_1000 = {"uniad": 150.0, "vad": 96.0, "sparsedrive": 135.0, "diffusiondrive": 132.0}
"""What the official code needs, measured on a machine with processors of the same kind."""
CATEGORIES = ("vehicle.car", "vehicle.car", "vehicle.truck", "human.pedestrian.adult", "movable_object.barrier")
SLOW: dict[str, Callable[[SampleTruth, Floats], list[bool]]] = {
    "exact": lambda truth, plan: slow.slow_exact(truth, plan).reshape(6, 5).any(axis=1).tolist(),
    "uniad": lambda truth, plan: slow.slow_uniad(truth, plan).collision,
    "vad": lambda truth, plan: slow.slow_vad(truth, plan).collision,
    "vad-23": lambda truth, plan: slow.slow_vad(truth, plan, slow.COUNTED_BY_VAD_23).collision,
    "sparsedrive": lambda truth, plan: slow.slow_sparsedrive(truth, plan).collision,
    "diffusiondrive": lambda truth, plan: slow.slow_sparsedrive(truth, plan).collision,
    "stp3": lambda truth, plan: further.slow_stp3(truth, plan).steps["collision"],
    "bev-planner": lambda truth, plan: further.slow_bev_planner(truth, plan).steps["collision"],
    "omnidrive": lambda truth, plan: further.slow_omnidrive(truth, plan).steps["collision"],
    "agent-driver": lambda truth, plan: slow.slow_uniad(truth, plan).collision,
}
"""Of those that latch, mirror or share flags with others there is no slow version of their own."""


def contacts_on_one_map(quick: bool, folder: Path) -> tuple[list[FaultCase], FaultRoads]:
    """The golden cases that have a map, each in a place of its own, several times over, and one map of all of them."""
    mapped = [case for case in read_cases(GoldenFolder(BUILT_IN)) if case.lanes]
    places = [
        (case, 1e4 * number, 1e4 * copy) for number, case in enumerate(mapped) for copy in range(1 if quick else 8)
    ]
    cases = [case.turned(0.0, (x, y)) for case, x, y in places]
    lanes = [
        replace(
            lane, identifier=f"{number}/{lane.identifier}", successors=tuple(f"{number}/{n}" for n in lane.successors)
        )
        for number, case in enumerate(cases)
        for lane in case.lanes or ()
    ]
    surfaces = {name: [shape for case in cases for shape in case.surfaces[name]] for name in LAYERS}
    return cases, FaultRoads(lanes, **surfaces, stop_lines=[line for case in cases for line in case.stop_lines])


def attribute_contacts(state: tuple[list[FaultCase], FaultRoads]) -> tuple[float, int]:
    """Verdicts on all; how many are not those of the set."""
    cases, roads = state
    found = [attribute_fault(case.tracks, roads, case.handedness) for case in cases]
    wrong = sum(
        (fault.verdict, fault.reason) != (case.verdict, case.reason) for fault, case in zip(found, cases, strict=True)
    )
    return len(cases), wrong


def adversary_of(scene: Scene) -> int:
    """The first car that moves 5 m or more: it costs what an adversary costs."""
    moved = np.ptp(scene.agents.position[..., :2], axis=1).max(axis=-1)
    return next(row for row, name in enumerate(scene.agents.categories) if name == "vehicle.car" and moved[row] >= 5.0)


def crowd_scene(scene: Scene, rng: np.random.Generator, objects: int = 30) -> Scene:
    """A scene of the town with other objects: so many, all the time, near the car's path; the map around it."""
    count, shape = len(scene.keyframes), (objects, len(scene.keyframes))
    path = scene.ego.pose[scene.keyframes]
    start = path[rng.integers(count, size=objects), :2] + rng.uniform(-40, 40, (objects, 2))
    yaw, speed = rng.uniform(-np.pi, np.pi, objects), rng.choice([0.0, 3.0, 8.0], objects)
    along = (speed[:, None] * scene.seconds[scene.keyframes])[..., None]
    position = np.zeros((*shape, 3))
    position[..., :2] = start[:, None] + (along % 60.0) * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)[:, None]
    annotations = Annotations(
        position=position,
        rotation=quaternion_from_yaw(np.repeat(yaw[:, None], count, axis=1)),
        size=np.broadcast_to(rng.uniform([3.5, 1.6, 1.5], [6.0, 2.2, 2.0], (objects, 1, 3)), position.shape),
        valid=rng.random(shape) < 0.95,
        attribute=np.full(shape, ""),
        visibility=np.full(shape, 4),
        num_lidar_pts=np.ones(shape, np.int64),
        num_radar_pts=np.zeros(shape, np.int64),
    )
    categories = tuple(CATEGORIES[row % len(CATEGORIES)] for row in range(objects))
    agents = replace(scene.agents, ids=tuple(map(str, range(objects))), categories=categories)
    (left, low), (right, high) = scene.ego.position[:, :2].min(0) - 120.0, scene.ego.position[:, :2].max(0) + 120.0
    near = scene.road_map.near((float(left), float(low), float(right), float(high)))
    return replace(scene, annotations=annotations, agents=agents, road_map=near)


def make_wandering_plans(recorded: RecordedScene, rng: np.random.Generator) -> list[Plan]:
    """Plans that wander off the recorded speed, for every key frame."""
    step = np.maximum(recorded.motion[:, 3], 1.0) / 2
    along = rng.normal(step[:, None], 0.8, (len(step), 6))
    waypoints = np.cumsum(np.stack([along, rng.normal(0, 0.15, along.shape)], axis=-1), axis=1)
    return [Plan(points, PlanFrame.EGO) for points in waypoints]


def busy_scenes(quick: bool, _folder: Path) -> tuple[list[tuple[Scene, list[Plan]]], int]:
    """About 6,019 samples that have a verdict, and how many the slow version judges."""
    rng, towns = np.random.default_rng(0), [build_town_scene("val", number) for number in range(1 if quick else 6)]
    scenes = [crowd_scene(towns[number % len(towns)], rng) for number in range(1 if quick else 178)]
    return [(scene, make_wandering_plans(RecordedScene(scene), rng)) for scene in scenes], 2 if quick else 8


def busy_samples(quick: bool, folder: Path) -> tuple[list[SampleTruth], Floats, int]:
    """Truths of those scenes, plans, and how many the slow version judges."""
    truths: list[SampleTruth] = []
    for number, (scene, _) in enumerate(busy_scenes(quick, folder)[0]):
        truths += compute_truth(scene, [f"{number} {index}" for index in range(len(scene.keyframes))])
    plans = np.random.default_rng(0).normal([0.0, 4.0], [0.3, 1.0], (len(truths), 6, 2)).cumsum(axis=1)
    return truths, plans, 6 if quick else 60


def protocol_case(name: str) -> Case:
    def slowly(state: Any) -> tuple[float, Any]:
        truths, plans, few = state
        return few, [SLOW[name](truth, plan) for truth, plan in zip(truths[:few], plans[:few])]

    official = OFFICIAL_S_PER_1000.get(name)
    return Case(
        f"protocols/{name}",
        f"Verdicts of {name} on 6,019 samples.",
        busy_samples,
        lambda state: (len(state[0]), PROTOCOLS[name].evaluate(*state[:2])),
        "sample",
        other=("slow version", slowly) if name in SLOW else None,
        same=(lambda state, found, slow: found.collision[: state[2]].tolist() == slow) if name in SLOW else None,
        more=(lambda *_: f"official code {official:.0f} ms") if official else None,
        fresh=True,
    )


def drive_scores(state: Any) -> tuple[float, Any]:
    verdicts = [score_scene_plans(scene, plans) for scene, plans in state[0]]
    # Samples without 3 s of recording after them cost nothing and do not count.
    return sum(score is not None for scene in verdicts for score in scene), verdicts[0]


def slow_drive_scores(state: Any) -> tuple[float, Any]:
    (scene, plans), few = state[0][0], state[1]
    recorded, ahead_m, scores = RecordedScene(scene), float(scene.lidar.translation[0]), {}
    samples = np.flatnonzero(recorded.complete)[3 : 3 + few]
    futures, frames = recorded.build_recorded_plans(samples), recorded.key_frames(samples)
    for place, sample in enumerate(samples.tolist()):
        now, past = np.append(recorded.motion[sample], np.zeros(3)), recorded.motion[sample - 3 : sample + 1]
        around = SlowSample(now, past, slow_objects(frames, place), recorded.road, recorded.route)
        verdict = slow_verdict(plan_to_poses(plans[sample], ahead_m), around)
        scores[sample] = verdict, slow_progress(verdict, slow_verdict(futures[place], around))
    return len(samples), scores


def same_drive_scores(_state: Any, fast: Any, slowly: Any) -> bool:
    return all(
        abs(fast[sample].ep - ep) <= 1e-5
        and all(
            getattr(fast[sample], name) == getattr(verdict, name) for name in ("nc", "dac", "ddc", "ttc", "lk", "hc")
        )
        for sample, (verdict, ep) in slowly.items()
    )


def make_hurried_plans(quick: bool, _folder: Path) -> list[tuple[list[SampleTruth], Floats]]:
    """Truths with an adversary, and plans that go where the recording goes, half as fast again."""
    samples = []
    for scene in (build_town_scene("val", number) for number in range(1 if quick else 10)):
        tokens = [f"{scene.name} {index}" for index in range(len(scene.keyframes))]
        adversaries = frozenset({scene.agents.ids[adversary_of(scene)]})
        truths = [replace(truth, adversaries=adversaries) for truth in compute_truth(scene, tokens)]
        samples.append((truths, np.array([truth.ego_future[:, :2] for truth in truths]) * 1.5))
    return samples


def plan_severity(state: Any) -> tuple[float, Any]:
    severities = [severity for truths, plans in state for severity in measure_plan_severities(truths, plans)]
    return len(severities), severities


def town_scenes(quick: bool, _folder: Path) -> list[tuple[Scene, ContinuousTracks, int]]:
    scenes = [build_town_scene("val", number) for number in range(2 if quick else 30)]
    return [(scene, ContinuousTracks.of_scene(scene), adversary_of(scene)) for scene in scenes]


def judge_scenes(state: Any) -> tuple[float, Any]:
    """Seconds by part."""
    spent: dict[str, float] = {}

    def timed(name: str, call: Callable[..., Any], *arguments: Any) -> Any:
        started = time.process_time()
        result = call(*arguments)
        spent[name] = spent.get(name, 0.0) + time.process_time() - started
        return result

    adversaries, recorded = {}, {}
    for scene, tracks, agent in state:
        area = scene.road_map.drivable_area
        timed("drivers", SceneReferenceDrivers.of, tracks, agent, None, area)
        timed("severity", measure_severity, tracks, agent)
        road = RoadEdge(area)
        of_agent, of_all = partial(extract_runs, road=road), partial(extract_recorded_runs, road=road)
        adversaries[scene.name] = timed("realism", of_agent, tracks, scene.keyframes, agent)
        recorded[scene.name] = timed("realism", of_all, tracks, scene.keyframes, "vehicle.car")
        timed("validity", find_track_defects, tracks, agent, slice(None), scene.road_map)
    timed("divergences", measure_realism, adversaries, recorded)
    return len(state), spent


def last_chances(state: Any) -> tuple[float, Any]:
    ladders = [
        SceneReferenceDrivers.of(tracks, agent, None, scene.road_map.drivable_area)
        for scene, tracks, agent in state[:5]
    ]
    return len(ladders), sum(bool(ladder.last_chance.evaluated) for ladder in ladders)


CASES = (
    *(protocol_case(name) for name in PROTOCOLS),
    Case(
        "protocols/all",
        "Verdicts of all protocols on 6,019 samples, one after the other.",
        busy_samples,
        lambda state: (len(state[0]), [protocol.evaluate(*state[:2]) for protocol in PROTOCOLS.values()] and None),
        "sample",
        fresh=True,
        most_s=15.0 / 6019,
    ),
    Case(
        "pdm",
        "The driving scores (`nuscenes-pdm`) of 6,019 samples of 30 objects with the town's map.",
        busy_scenes,
        drive_scores,
        "sample",
        other=("slow version", slow_drive_scores),
        same=same_drive_scores,
        fresh=True,
        most_s=45.0 / 6019,
    ),
    Case(
        "plan-severity",
        "How severe plans are: what `eval` spends on a sample beside protocols and driving scores.",
        make_hurried_plans,
        plan_severity,
        "sample",
        more=lambda _, found: f"{sum(each.contact is not None for each in found)} of {len(found)} touch somebody",
        fresh=True,
        most_s=0.001,
    ),
    Case(
        "fault",
        "Whose fault contacts are (`fault@1`), on one map of some 1,500 lanes.",
        contacts_on_one_map,
        attribute_contacts,
        "contact",
        more=lambda _, wrong: f"{wrong} verdicts differ from the golden set",
        most_s=0.005,
    ),
    Case(
        "judgement/scenes",
        "Reference drivers, severity and realism of scenes of the town, last chances apart.",
        town_scenes,
        judge_scenes,
        "scene",
        more=lambda state, spent: ", ".join(f"{name} {1e3 * s / len(state):.0f} ms" for name, s in spent.items()),
        fresh=True,
        most_s=60.0 / 150,
    ),
    Case(
        "judgement/last-chances",
        "Reference drivers and last chances of scenes of the town.",
        town_scenes,
        last_chances,
        "scene",
        more=lambda _, evaluated: f"{evaluated} have one",
        fresh=True,
        most_s=2.0,
    ),
)
