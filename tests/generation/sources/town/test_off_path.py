"""The ego off its path: drivable, touching nobody, back on the path, and none of the departing is learned."""

import numpy as np
import pytest

from benchmark.dynamics.bicycle import DriverLimits, find_broken_limit
from benchmark.geometry import Floats, box_corners, boxes_overlap, wrap_angle
from benchmark.records.off_path import OFF_PATH, Excursion, read_excursions
from benchmark.scene import Scene
from generation.sources.town import build_town_scene, build_town_scene_off_path, list_town_scene_names
from generation.sources.town.off_path import KEPT_ON_PATH_EVERY
from generation.sources.town.paths import EGO_BODY, compute_body_boxes
from generation.sources.town.speed import FRAMES

INDICES = (0, 5)
RESTORED_M, RESTORED_RAD = 0.02, 0.01


def _rear(scene: Scene) -> Floats:
    w, z = scene.ego.rotation[:, 0], scene.ego.rotation[:, 3]
    return np.column_stack([scene.ego.position[:, :2], 2 * np.arctan2(z, w)])


Pair = tuple[Scene, Scene, tuple[Excursion, ...]]


@pytest.fixture(scope="module", params=INDICES)
def pair(request: pytest.FixtureRequest) -> Pair:
    """The scene as planned, the one off the path, and its excursions."""
    return build_town_scene("train", request.param), *build_town_scene_off_path(request.param)


def test_the_ego_leaves_its_path_and_can_drive_what_it_drives(pair: Pair) -> None:
    planned, scene, excursions = pair
    assert excursions
    boxes = compute_body_boxes(_rear(scene), EGO_BODY)
    assert find_broken_limit(boxes, DriverLimits(), rounded_m=1e-6) is None
    apart = np.hypot(*(scene.ego.position - planned.ego.position)[:, :2].T)
    for each in excursions:
        during = slice(int(each.begin_s * 12), int(each.end_s * 12) + 1)
        assert apart[during].max() > 0.1, each


def test_between_excursions_it_is_where_it_would_be(pair: Pair) -> None:
    planned, scene, excursions = pair
    seconds = np.arange(FRAMES) / 12
    away = np.zeros(FRAMES, dtype=np.bool_)
    for each in excursions:
        away |= (seconds > each.begin_s) & (seconds < each.end_s)
    assert not away.all()
    before, after = _rear(planned)[~away], _rear(scene)[~away]
    assert np.hypot(*(before - after)[:, :2].T).max() < RESTORED_M
    assert np.abs(wrap_angle(before[:, 2] - after[:, 2])).max() < RESTORED_RAD


def test_it_touches_nobody_and_stays_on_the_road(pair: Pair) -> None:
    _, scene, _ = pair
    own = compute_body_boxes(_rear(scene), EGO_BODY)
    agents = scene.agents
    for row in range(len(agents.ids)):
        size = np.broadcast_to(agents.size[row, :2], (FRAMES, 2))
        boxes = np.column_stack([agents.position[row, :, :2], size, agents.yaw[row]])
        assert not (boxes_overlap(own, boxes) & agents.valid[row]).any()
    shrunk = own - np.array([0, 0, 0.2, 0.2, 0])
    assert scene.road_map.is_drivable(box_corners(shrunk)[::12]).all()


def test_others_do_what_they_did(pair: Pair) -> None:
    planned, scene, _ = pair
    rows = {agent: row for row, agent in enumerate(planned.agents.ids)}
    shared = [(row, rows[agent]) for row, agent in enumerate(scene.agents.ids) if agent in rows]
    assert len(shared) >= 0.9 * len(rows)
    for here, there in shared:
        both = scene.agents.valid[here] & planned.agents.valid[there]
        if scene.agents.categories[here] == planned.agents.categories[there]:
            assert np.array_equal(scene.agents.position[here][both], planned.agents.position[there][both])


def test_some_scenes_stay_on_their_path() -> None:
    index = KEPT_ON_PATH_EVERY - 1
    scene, excursions = build_town_scene_off_path(index)
    assert excursions == ()
    assert np.array_equal(scene.ego.position, build_town_scene("train", index).ego.position)


def test_the_same_index_gives_the_same_bytes_which_are_read_back(pair: Pair) -> None:
    _, scene, excursions = pair
    again, same = build_town_scene_off_path(list_town_scene_names("train", 10).index(scene.name))
    assert same == excursions and again.ego.position.tobytes() == scene.ego.position.tobytes()
    made = {"scenes": {scene.name: {"report": {OFF_PATH: [each.as_json() for each in excursions]}}}}
    assert read_excursions(made, scene.name) == excursions
