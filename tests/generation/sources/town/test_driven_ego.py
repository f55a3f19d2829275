"""Where a planner drove the ego of the town, the way back is one that a good driver would drive."""

import numpy as np
import pytest

from benchmark.constants import FRAMES_PER_KEYFRAME, PLAN_STEPS
from benchmark.datasets.sample_truth import compute_planar_lidar_poses
from benchmark.dynamics.bicycle import DriverLimits
from benchmark.errors import InputError
from benchmark.geometry import Floats, boxes_overlap, to_local, wrap_angle
from benchmark.planning import Command
from benchmark.records.driven_ego import DRIVEN, DrivenEgoTargets, read_driven_ego_targets
from benchmark.scene import Scene
from generation.sources.town import build_town_scene, build_town_scene_driven
from generation.sources.town.driven_ego import PlannerDrive
from generation.sources.town.paths import EGO_BODY, compute_body_boxes

INDEX = 0
KEYFRAMES = 40


@pytest.fixture(scope="module")
def planned() -> Scene:
    return build_town_scene("train", INDEX)


def driven_as(scene: Scene, *, aside_m: float = 0.0, faster: float = 1.0, count: int = KEYFRAMES) -> PlannerDrive:
    """The town's driver, to the left of where they would be and at another speed."""
    poses = scene.ego.pose[scene.keyframes][:count]
    normal = np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])
    aside = np.where(np.arange(count) > 0, aside_m, 0.0)
    moved = np.column_stack([poses[:, :2] + aside[:, None] * normal, poses[:, 2]])
    step = np.hypot(*np.diff(scene.ego.position[:, :2], axis=0).T) * 12
    speeds = np.append(step, step[-1])[:: len(scene.timestamps_us) // KEYFRAMES][:count]
    return PlannerDrive("somebody", moved, faster * speeds, (Command.STRAIGHT,) * count)


def wanted_from(scene: Scene, learned: DrivenEgoTargets, keyframe: int) -> Floats:
    """(6, 2) forward and left of the lidar."""
    return to_local(learned.wanted[keyframe], compute_planar_lidar_poses(scene)[keyframe])


Drive = tuple[Scene, DrivenEgoTargets]


@pytest.fixture(scope="module")
def aside(planned: Scene) -> Drive:
    """0.8 m to the left of the path."""
    return build_town_scene_driven(INDEX, driven_as(planned, aside_m=0.8))


def test_who_drives_as_the_town_does_is_to_go_on_so(planned: Scene) -> None:
    scene, learned = build_town_scene_driven(INDEX, driven_as(planned))
    assert np.abs(scene.ego.position[scene.keyframes] - planned.ego.position[scene.keyframes]).max() < 1e-3
    lidar = compute_planar_lidar_poses(planned)
    # Speeds are those of the twelfth of a second after each key frame, and the path is held every half metre.
    for keyframe in range(KEYFRAMES - PLAN_STEPS):
        future = lidar[keyframe + 1 : keyframe + 1 + PLAN_STEPS, :2]
        assert np.abs(learned.wanted[keyframe] - future).max() < 0.2, keyframe


def test_between_key_frames_the_ego_moves_as_fast_as_it_was(planned: Scene) -> None:
    driven = driven_as(planned)
    rear = driven.rear()
    assert np.abs(rear[::FRAMES_PER_KEYFRAME][:KEYFRAMES, :2] - driven.poses[:, :2]).max() < 1e-9
    assert np.abs(rear[:235, :2] - planned.ego.position[:235, :2]).max() < 0.05
    assert np.abs(wrap_angle(rear[:235, 2] - planned.ego.pose[:235, 2])).max() < 0.01


def test_who_is_beside_the_path_is_to_come_back_to_it(planned: Scene, aside: Drive) -> None:
    scene, learned = aside
    known = np.flatnonzero(learned.known[1 : KEYFRAMES - PLAN_STEPS].all(-1)) + 1
    assert len(known) > 20
    lidar = compute_planar_lidar_poses(planned)
    for keyframe in known:
        off = to_local(learned.wanted[keyframe][:, None], lidar[None, keyframe + 1 : keyframe + 1 + PLAN_STEPS])
        beside = np.array([off[step, step, 1] for step in range(PLAN_STEPS)])
        # Half a second on it is still there, after three it is nearly back, and it never swings to the other side.
        assert beside[0] > 0.5 * 0.8 and abs(beside[-1]) < 0.35 * 0.8
        assert (beside > -0.25).all()
        # It goes on from where the ego is, and with its speed.
        first = wanted_from(scene, learned, keyframe)[0]
        assert first[0] == pytest.approx(0.5 * driven_as(planned).speeds[keyframe], abs=0.7)
        assert abs(first[1]) < 0.5


def test_who_is_late_is_to_drive_as_the_town_does_at_the_same_places(planned: Scene) -> None:
    late = 3
    on_time = driven_as(planned)
    begun = np.maximum(np.arange(KEYFRAMES) - late, 0)
    driven = PlannerDrive("somebody", on_time.poses[begun], on_time.speeds[begun], on_time.commands)
    _, learned = build_town_scene_driven(INDEX, driven)
    lidar = compute_planar_lidar_poses(planned)
    apart = []
    for keyframe in range(late, KEYFRAMES - PLAN_STEPS):
        place = keyframe - late
        future = lidar[place + 1 : place + 1 + PLAN_STEPS, :2]
        apart.append(np.abs(learned.wanted[keyframe] - future).max())
    # Others did not wait for it, so that now and then it has to do something else.
    assert np.nanquantile(apart, 0.5) < 0.2


def test_the_way_back_touches_nobody_and_no_driver_brakes_harder(planned: Scene) -> None:
    scene, learned = build_town_scene_driven(INDEX, driven_as(planned, faster=1.3))
    agents = scene.agents
    assert learned.known.any()
    for keyframe in range(KEYFRAMES):
        frame = FRAMES_PER_KEYFRAME * keyframe
        steps = frame + FRAMES_PER_KEYFRAME * (1 + np.flatnonzero(learned.known[keyframe]))
        rows = [row for row in range(len(agents)) if agents.valid[row, steps[steps < scene.keyframes[-1]]].any()]
        places = learned.wanted[keyframe][learned.known[keyframe]]
        course = np.diff(np.concatenate([compute_planar_lidar_poses(scene)[keyframe][None, :2], places]), axis=0)
        moved = np.hypot(*course.T)
        assert (moved > -1e-9).all()
        speeds = moved / 0.5
        assert (np.diff(speeds) / 0.5 > -1.3 * DriverLimits().braking_m_s2).all()
        heading = np.arctan2(course[:, 1], course[:, 0])
        lidar = np.column_stack([places, heading])
        ahead_m = float(scene.lidar.translation[0])
        rear = lidar - ahead_m * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(heading))])
        for place, step, far in zip(compute_body_boxes(rear, EGO_BODY), steps, moved, strict=True):
            if step >= len(scene.timestamps_us) or far < 0.5:
                continue
            own = place - np.array([0, 0, 0.3, 0.3, 0])
            for row in rows:
                if agents.valid[row, step]:
                    assert not boxes_overlap(own, agents.boxes[row, step]), (keyframe, step, row)


def test_who_went_astray_shows_nothing(planned: Scene) -> None:
    _, learned = build_town_scene_driven(INDEX, driven_as(planned, aside_m=5.0))
    assert learned.known[0].all()
    assert not learned.known[1:].any()


def test_a_drive_that_ended_early_makes_a_short_scene(planned: Scene) -> None:
    scene, learned = build_town_scene_driven(INDEX, driven_as(planned, count=11))
    assert len(scene.keyframes) == len(learned.commands) == len(learned.wanted) == 11
    assert scene.timestamps_us[-1] - scene.timestamps_us[0] == 5_000_000
    # The town goes on: where to go is known beyond the last picture.
    assert learned.known.all()


def test_drives_of_another_town_are_refused(planned: Scene) -> None:
    with pytest.raises(InputError, match="seed"):
        build_town_scene_driven(INDEX, driven_as(planned), seed=1)


def test_what_is_written_of_a_drive_is_read_back(aside: Drive) -> None:
    scene, learned = aside
    made = {"scenes": {scene.name: {"report": {DRIVEN: learned.as_json()}}}}
    back = read_driven_ego_targets(made, scene.name)
    assert back is not None
    assert (back.planner, back.commands) == (learned.planner, learned.commands)
    assert np.array_equal(back.known, learned.known)
    assert np.nanmax(np.abs(back.wanted - learned.wanted)) <= 5.1e-4
    assert read_driven_ego_targets({"scenes": {scene.name: {"report": {}}}}, scene.name) is None
    assert read_driven_ego_targets(None, scene.name) is None
