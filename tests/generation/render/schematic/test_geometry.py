"""Where things appear: against an independent pinhole projection, and what hides what."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from nuscenes.utils.geometry_utils import view_points
from pyquaternion import Quaternion

from benchmark.geometry import Floats, box_corners
from benchmark.scene import Camera, EgoTrack, Scene
from generation.render.schematic import SchematicRenderer
from generation.render.schematic.solids import compute_drawing_order
from generation.render.schematic.view import clip_near
from tests.hand_made import Car, scene_on_straight_road

CRATE = "movable_object.pushable_pullable"


def devkit_pixels(points: Floats, scene: Scene, camera: Camera) -> tuple[Floats, Floats]:
    """Pixels and depths of global points (M, 3), by the devkit's own functions."""
    moved = points - scene.ego.position[0]
    moved = moved @ Quaternion(scene.ego.rotation[0]).rotation_matrix - camera.translation
    moved = moved @ Quaternion(camera.rotation).rotation_matrix
    return view_points(moved.T, camera.intrinsic, normalize=True)[:2].T, moved[:, 2]


def with_ego(scene: Scene, rotation: Quaternion, z: float) -> Scene:
    count = len(scene.timestamps_us)
    position = scene.ego.position + np.array([0.0, 0.0, z])
    agents = dataclasses.replace(scene.agents, position=scene.agents.position + np.array([0.0, 0.0, z]))
    ego = EgoTrack(position, np.tile(rotation.elements, (count, 1)))
    return dataclasses.replace(scene, ego=ego, agents=agents)


def picture(scene: Scene, camera: str, size: tuple[int, int] = (448, 256)) -> NDArray[np.uint8]:
    return next(SchematicRenderer(*size).render(scene, [0]))[camera]


STANCES = [
    (Quaternion(), 0.0),
    (Quaternion(axis=[0, 0, 1], degrees=10) * Quaternion(axis=[0, 1, 0], degrees=2), 3.0),
    (Quaternion(axis=[1, 0, 0], degrees=4), -1.0),
]


@pytest.fixture(scope="module", params=STANCES, ids=("level", "pitched", "rolled"))
def stance(request: pytest.FixtureRequest) -> tuple[Quaternion, float]:
    return request.param  # type: ignore[no-any-return]


def test_crates_appear_where_their_corners_project(stance: tuple[Quaternion, float]) -> None:
    empty = with_ego(scene_on_straight_road((), seconds=0.5), *stance)
    cameras = SchematicRenderer().cameras(empty)
    places = []
    for camera in cameras:
        axis = Quaternion(empty.ego.rotation[0]).rotate(Quaternion(camera.rotation).rotate(np.array([0.0, 0.0, 1.0])))
        places.append(empty.ego.position[0, :2] + 9.0 * axis[:2] / np.hypot(*axis[:2]))
    crates = tuple(Car(x, y, 0.0, 0.4, CRATE, (1.0, 1.2, 0.9)) for x, y in places)
    scene = with_ego(scene_on_straight_road(crates, seconds=0.5), *stance)
    with_crates, without = (next(SchematicRenderer().render(s, [0])) for s in (scene, empty))
    for camera, (x, y) in zip(cameras, places):
        change = np.abs(with_crates[camera.name].astype(int) - without[camera.name]).max(axis=-1) > 6
        outline = box_corners(np.array([x, y, 1.0, 1.2, 0.4]))
        z = scene.ego.position[0, 2]
        corners = np.concatenate([np.column_stack([outline, np.full(4, z + h)]) for h in (0.0, 0.9)])
        pixels, depth = devkit_pixels(corners, scene, camera)
        assert (depth > 0).all()
        middle = np.rint(pixels.mean(axis=0)).astype(int)
        around = np.zeros_like(change)
        around[max(middle[1] - 60, 0) : middle[1] + 60, max(middle[0] - 60, 0) : middle[0] + 60] = True
        rows, columns = np.nonzero(change & around)
        low, high = pixels.min(axis=0), np.minimum(pixels.max(axis=0), [447, 255])
        assert columns.min() == pytest.approx(low[0] + 1, abs=4) and columns.max() == pytest.approx(high[0] - 1, abs=4)
        assert rows.min() == pytest.approx(low[1] + 1, abs=4) and rows.max() == pytest.approx(high[1] - 1, abs=4)


def test_the_middle_line_is_yellow_where_its_points_project(stance: tuple[Quaternion, float]) -> None:
    scene = with_ego(scene_on_straight_road((), seconds=0.5), *stance)
    points = np.column_stack([np.linspace(58.0, 76.0, 40), np.full(40, 200.0), np.full(40, scene.ego.position[0, 2])])
    renderer, seen = SchematicRenderer(800, 450), 0
    images = next(renderer.render(scene, [0]))
    for camera in renderer.cameras(scene):
        pixels, depth = devkit_pixels(points, scene, camera)
        inside = (depth > 1) & (pixels >= 1).all(axis=1) & (pixels < [798, 448]).all(axis=1)
        for column, row in np.rint(pixels[inside]).astype(int):
            red, _, blue = images[camera.name][row, column].astype(int)
            assert red > blue + 40
            seen += 1
    assert seen > 20


def test_zebra_stripes_alternate_across_the_road() -> None:
    scene = scene_on_straight_road((), ego_x=138.0, seconds=0.5)
    camera = SchematicRenderer(1200, 675).cameras(scene)[0]
    across = np.arange(195.0, 205.0, 0.05)
    points = np.column_stack([np.full(len(across), 152.0), across, np.zeros(len(across))])
    pixels, _ = devkit_pixels(points, scene, camera)
    inside = (pixels >= 0).all(axis=1) & (pixels < [1199, 674]).all(axis=1)
    columns, rows = np.rint(pixels[inside]).astype(int).T
    bright = picture(scene, "CAM_FRONT", (1200, 675))[rows, columns].min(axis=1) > 170
    changes = int((np.diff(bright.astype(int)) != 0).sum())
    assert 0.35 < bright.mean() < 0.65
    assert 12 <= changes <= 24


def test_a_near_truck_hides_the_car_behind_it() -> None:
    truck = Car(66.0, 198.25, 8.0, 0.0, "vehicle.truck", (8.0, 2.6, 3.4))
    hidden = Car(76.0, 198.25, 8.0)
    alone = scene_on_straight_road((truck,), seconds=0.5)
    for cars in ((truck, hidden), (hidden, truck)):
        both = scene_on_straight_road(cars, seconds=0.5)
        ids = {truck: alone.agents.ids[0], hidden: "hidden"}
        both = dataclasses.replace(both, agents=dataclasses.replace(both.agents, ids=tuple(ids[car] for car in cars)))
        assert np.array_equal(picture(both, "CAM_FRONT"), picture(alone, "CAM_FRONT"))


def test_a_near_car_covers_part_of_a_far_one() -> None:
    near, far = Car(62.0, 196.0, 8.0), Car(70.0, 198.25, 8.0)
    one, both = scene_on_straight_road((near,), seconds=0.5), scene_on_straight_road((near, far), seconds=0.5)
    camera = SchematicRenderer().cameras(one)[0]
    centre = np.array([[62.0 - 2.3, 196.0, 0.7]])
    column, row = np.rint(devkit_pixels(centre, one, camera)[0][0]).astype(int)
    images = [picture(scene, "CAM_FRONT") for scene in (one, both)]
    assert not np.array_equal(images[0], images[1])
    assert np.array_equal(images[0][row - 4 : row + 5, column - 4 : column + 5],
                          images[1][row - 4 : row + 5, column - 4 : column + 5])  # fmt: skip


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 14))
def test_drawing_order_never_draws_the_nearer_first(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    cells = random.choice(49, count, replace=False)
    centres = (np.stack([cells // 7, cells % 7], axis=-1) - 3.0) * 6.0 + 3.0
    boxes = np.column_stack([centres, random.uniform(0.4, 5.0, count), random.uniform(0.3, 2.5, count),
                             random.uniform(-np.pi, np.pi, count)])  # fmt: skip
    corners = box_corners(boxes)
    order = compute_drawing_order(corners, np.zeros(2))
    assert sorted(order) == list(range(count))
    rank = np.argsort(order)
    for angle in random.uniform(-np.pi, np.pi, 24):
        # Oracle: march along the ray; whatever it meets later must have been drawn before what it met earlier.
        steps = np.arange(0.0, 34.0, 0.08)[:, None] * np.array([np.cos(angle), np.sin(angle)])
        side = np.roll(corners, -1, axis=1) - corners
        offset = steps[:, None, None] - corners[None]
        inside = (side[..., 0] * offset[..., 1] - side[..., 1] * offset[..., 0] > 0.0).all(axis=-1)
        met = [int(np.argmax(inside[:, i])) if inside[:, i].any() else None for i in range(count)]
        hit = sorted((step, i) for i, step in enumerate(met) if step is not None)
        ranks = [rank[i] for _, i in hit]
        assert ranks == sorted(ranks, reverse=True)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_clipping_keeps_what_is_ahead_and_nothing_else(seed: int) -> None:
    polygon = np.random.default_rng(seed).uniform(-2, 2, (4, 3))
    clipped = clip_near(polygon, 0.2)
    assert (clipped[:, 2] >= 0.2 - 1e-12).all() if len(clipped) else (polygon[:, 2] < 0.2).all()
    kept = [tuple(point) for point in polygon if point[2] >= 0.2]
    assert set(kept) <= {tuple(point) for point in clipped}
