"""One kept scene judged for `bench.threat`: who survives it, what ``constant-velocity`` hits, and its faults."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import shapely

from adapters.planners.constant_velocity import ConstantVelocity
from benchmark.constants import PLAN_STEP_S
from benchmark.datasets.roots import DataSet
from benchmark.datasets.sample_truth import planar_lidar_poses, truth_of_scene
from benchmark.fairness.features import Run, recorded_runs, runs_of
from benchmark.fairness.validity import faults_of
from benchmark.geometry import Floats, box_corners, to_global
from benchmark.interactions.contacts import KINDS, Pairs, at_fault, is_agent
from benchmark.interactions.reaction import Driver
from benchmark.interactions.solvability import SceneLadder
from benchmark.interactions.tracks import Tracks
from benchmark.protocols.exact import INSTANTS_PER_STEP, Exact, ego_boxes
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from generation.search.chains import Chain

CATEGORY = "vehicle.car"
"""Recorded agents that an adversary is compared with."""


@dataclass(frozen=True)
class Attacked:
    """One kept scene.

    Attributes:
        scene: Its name.
        manoeuvre: The primary kind.
        careful_survives: Whether the careful and competent human does.
        constant_survives: Whether a driver at constant speed does.
        at_fault: Whether the plan of ``constant-velocity`` hits the adversary first and at fault at some sample.
        colliding: Samples whose plan hits anything (the paper's rate).
        samples: That count.
        faults: What is wrong with the adversary's motion.
        runs: Its motion features.
    """

    scene: str
    manoeuvre: str
    careful_survives: bool
    constant_survives: bool
    at_fault: bool
    colliding: int
    samples: int
    faults: tuple[str, ...]
    runs: tuple[Run, ...]

    def as_json(self) -> dict[str, Any]:
        """All but the features."""
        return {name: value for name, value in asdict(self).items() if name != "runs"}


def attacked(source: DataSet, chain: Chain) -> Attacked:
    """Judge a scene with one adversary.

    Args:
        source: The recordings.
        chain: The adversary.

    Returns:
        The verdicts.
    """
    link = chain.links[-1]
    scene = chain.adversarial(source.scene(chain.scene_name))
    agent, start, labels = link.unit.agent, link.attempt.launch_frame, link.attempt.labels
    assert start is not None and labels is not None, "a kept adversary was launched and is described"
    tracks = Tracks.of_scene(scene)
    ladder = SceneLadder.of(tracks, agent)
    blamed, colliding, samples = judged_plans(source, scene, chain.scene_name, tracks, agent)
    faults = faults_of(tracks, agent, slice(start, None), scene.road_map)
    launched = (float(scene.seconds[start]), float(scene.seconds[-1]))
    return Attacked(
        scene=chain.name,
        manoeuvre=labels.manoeuvre,
        careful_survives=ladder.survives(Driver.CC),
        constant_survives=ladder.survives(Driver.CONSTANT),
        at_fault=blamed,
        colliding=colliding,
        samples=samples,
        faults=tuple(name for name, found in asdict(faults).items() if found),
        runs=tuple(runs_of(tracks, scene.keyframes, agent, between=launched)),
    )


def judged_plans(source: DataSet, scene: Scene, name: str, tracks: Tracks, agent: int) -> tuple[bool, int, int]:
    """Plans of ``constant-velocity`` at every sample of an adversarial scene.

    Args:
        source: The recordings, whose ego the adversary does not change.
        scene: The adversarial scene.
        name: Of the recording.
        tracks: Its tracks.
        agent: Index of the adversary.

    Returns:
        Whether some plan hits the adversary first and is to blame, how many plans hit anything, and of how many.
    """
    plans = _plans(source, name)
    outcomes = Exact().evaluate(truth_of_scene(scene, [str(index) for index in range(len(plans))]), plans)
    hits, times = outcomes.facts["hit"], outcomes.facts["first_contact_s"]
    poses = planar_lidar_poses(scene)
    blamed = any(
        _to_blame(scene, tracks, agent, poses[index], plans[index], float(times[index]), index)
        for index in np.flatnonzero(outcomes.counted).tolist()
        if hits[index] == scene.agents.ids[agent]
    )
    return blamed, int((outcomes.collision.any(axis=1) & outcomes.counted).sum()), int(outcomes.counted.sum())


def _plans(source: DataSet, name: str) -> Floats:
    """(K, 6, 2) waypoints of the lidar."""
    planner, ahead_m = ConstantVelocity(), float(source.scene(name).lidar.translation[0])
    return np.array([planner.plan(seen).waypoints_in_lidar(ahead_m) for seen in source.observations(name)])


def _to_blame(scene: Scene, tracks: Tracks, agent: int, pose: Floats, plan: Floats, after_s: float, index: int) -> bool:
    """Whether a plan is at fault in its first contact, so many seconds after the sample."""
    instant = round(after_s * INSTANTS_PER_STEP / PLAN_STEP_S) - 1
    box = ego_boxes(plan)[instant]
    frame = pose - [0.0, 0.0, np.pi / 2]
    box[:2] = to_global(box[:2], frame)
    box[4] += frame[2]
    step = instant // INSTANTS_PER_STEP
    before = plan[step - 1] if step else np.zeros(2)
    time = np.array([float(scene.seconds[scene.keyframes[index]]) + after_s])
    others, _ = tracks.agents_at(time)
    pair = Pairs(
        ego=box[None],
        ego_speed=np.array([np.hypot(*(plan[step] - before)) / PLAN_STEP_S]),
        other=others[agent],
        other_velocity=tracks.velocities_at(time, np.array([agent]))[0],
        is_agent=np.array([is_agent(tracks.categories[agent])]),
    )
    return at_fault(KINDS[pair.kinds[0]], _unsure(scene.road_map, box))


def _unsure(road_map: RoadMap, box: Floats) -> bool:
    """Whether a car is off the drivable area, or on more than one lane and on none altogether."""
    corners = box_corners(box[None])[0]
    if not road_map.is_drivable(corners).all():
        return True
    lanes = [lane.polygon for lane in road_map.lanes.values() if lane.polygon is not None]
    on = np.array([shapely.contains_xy(lane, *corners.T) for lane in lanes]).reshape(len(lanes), 4)
    return int(on.any(axis=1).sum()) > 1 and not bool(on.all(axis=1).any())


def recorded_features(source: DataSet, name: str) -> list[Run]:
    """Motion features of all recorded cars of a scene."""
    scene = source.scene(name)
    return recorded_runs(Tracks.of_scene(scene), scene.keyframes, CATEGORY)
