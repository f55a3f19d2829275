"""What stands in a sheet: tracks, road and edges against the scene that they were made from."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from benchmark.box_projection import BOX_EDGES, compute_box_corners, interpolate_agents, to_camera
from benchmark.errors import InputError
from benchmark.geometry import transform_matrix
from benchmark.planning import CameraView
from benchmark.records.scene_pages import CAMERA_GRID, PageMap
from benchmark.road_map import Divider, DividerKind, RoadMap, as_multipolygon
from benchmark.scene import Scene
from benchmark.scene_pages.page_building import AROUND_M, build_page_map
from benchmark.scene_pages.page_pictures import (
    clip_segment,
    draw_mosaic,
    lay_out_cameras,
    project_adversary_edges,
    select_pictured_frames,
)
from benchmark.scene_pages.page_tracks import build_agent_tracks, build_ego_track, find_origin
from tests.generation.nuscenes_writer.written_roots import short_scene, with_adversary
from tests.hand_made import Car, straight_road, without_frames

WAY = np.column_stack([np.linspace(150.0, 190.0, 9), np.full(9, 198.25)])


def test_positions_are_the_scenes_to_the_centimetre() -> None:
    scene = short_scene()
    scene = replace(scene, agents=replace(scene.agents, yaw=scene.agents.yaw + 40 * np.pi + 0.1234))
    origin, agents = find_origin(scene), scene.agents
    ego = build_ego_track(scene, origin)
    assert origin == (50.0, 198.0)
    shown = [(ego.x_m, ego.y_m), *((each.x_m, each.y_m) for each in build_agent_tracks(scene, origin))]
    for (x_m, y_m), expected in zip(shown, [scene.ego.position, *agents.position]):
        there = np.column_stack([np.array(x_m, float), np.array(y_m, float)]) + origin
        assert np.abs(there - expected[:, :2]).max() <= 0.0051
    for agent, yaw in zip(build_agent_tracks(scene, origin), agents.yaw, strict=True):
        turned = np.array(agent.yaw_rad, float)
        assert np.abs(np.angle(np.exp(1j * (turned - yaw)))).max() <= 0.0006 and np.abs(turned).max() <= 3.142
        assert agent.size_m == (4.6, 1.9, 1.7)


def test_agents_are_shown_while_they_are_near_and_there_an_adversary_last_and_however_far() -> None:
    cars = (Car(80.0, 198.25, 8.0), Car(160.0, 201.75, 20.0, np.pi), Car(350.0, 194.75))
    scene = without_frames(short_scene(cars=cars, ego_speed=0.0), 0, slice(1, 3))
    shown = build_agent_tracks(scene, find_origin(scene))
    assert [agent.id for agent in shown] == list(scene.agents.ids[:2])
    away, coming = shown
    assert [value is None for value in away.x_m] == [not there for there in scene.agents.valid[0]]
    assert [value is None for value in away.yaw_rad] == [value is None for value in away.x_m]
    # 110 m ahead at first and 3.5 m to the side; at 20 m/s it is within 80 m after a little more than 1.5 s.
    assert coming.first == 19 and len(coming.x_m) == len(scene.timestamps_us) - 19
    far = with_adversary(short_scene(cars=(Car(390.0, 198.25), Car(80.0, 194.75))))
    near, adversary = build_agent_tracks(far, find_origin(far))
    assert (near.adversary, adversary.adversary) == (False, True)
    assert adversary.id == far.adversaries[0] and len(adversary.x_m) == len(far.timestamps_us)


def test_the_road_is_that_around_the_way() -> None:
    road = build_page_map(straight_road(), WAY, (150.0, 198.0))
    corridor = shapely.LineString(WAY).buffer(AROUND_M)
    (outer,) = road.drivable[0]
    drawn = shapely.transform(shapely.Polygon(outer), lambda points: points + [150.0, 198.0])
    expected = straight_road().drivable_area.intersection(corridor)
    assert drawn.symmetric_difference(expected).area < 0.02 * expected.area
    assert len(road.drivable) == len(road.crossings) == 1 and len(road.walkways) == 2
    assert sorted(line.paint for line in road.dividers) == ["dashed-white", "dashed-white", "solid-yellow"]
    for polygon in (*road.drivable, *road.crossings, *road.walkways, *road.carparks):
        for ring in polygon:
            assert ring[0] == ring[-1] and np.array_equal(np.round(ring, 2), np.array(ring))


def test_holes_stay_and_slivers_go() -> None:
    island = shapely.Polygon(shapely.box(100, 150, 250, 250).exterior, [shapely.box(160, 190, 170, 195).exterior])
    area = as_multipolygon(shapely.MultiPolygon([island, shapely.box(300, 100, 300.0001, 101)]))
    twisted = shapely.Polygon([(150, 180), (160, 190), (160, 180), (150, 190)])
    road = build_page_map(RoadMap("boston-seaport", area, carparks={"x": twisted}), WAY, (0.0, 0.0))
    assert [len(polygon) for polygon in road.drivable] == [2] and len(road.carparks) == 2


def test_an_ego_that_stands_has_a_road() -> None:
    for way in (WAY[:1], np.repeat(WAY[:1], 5, axis=0)):
        assert build_page_map(straight_road(), way, (150.0, 198.0)).drivable
    assert build_page_map(RoadMap("nowhere", shapely.MultiPolygon()), WAY, (0.0, 0.0)) == PageMap()


def test_a_winding_border_is_simplified_by_no_more_than_5_cm() -> None:
    angles = np.linspace(0, 2 * np.pi, 20_001)[:-1]
    radius = 30 + 0.02 * np.sin(900 * angles)
    disc = shapely.Polygon(np.column_stack([170 + radius * np.cos(angles), 198 + radius * np.sin(angles)]))
    wave = Divider("wave", np.asarray(disc.exterior.coords), DividerKind.UNPAINTED, False)
    road = build_page_map(RoadMap("x", as_multipolygon(disc), dividers=(wave,)), WAY, (0.0, 0.0))
    (outer,) = road.drivable[0]
    assert len(outer) < 200
    assert shapely.Polygon(outer).exterior.hausdorff_distance(disc.exterior) < 0.06
    assert len(road.dividers[0].points) < 200


def view_of(scene: Scene, name: str, frame: int) -> CameraView:
    camera = next(camera for camera in scene.cameras if camera.name == name)
    pose = transform_matrix(scene.ego.rotation[frame], scene.ego.position[frame])
    return CameraView(camera, None, int(scene.timestamps_us[frame]), pose, None)  # type: ignore[arg-type]


def outline_of_adversary(scene: Scene, view: CameraView, size: tuple[int, int]) -> shapely.Polygon | None:
    """The hull of what of its box is 0.1 m ahead of the camera or more, inside the picture."""
    camera, agent = view.camera.resized(*size), scene.agents.ids.index(scene.adversaries[0])
    positions, yaws, _ = interpolate_agents(scene, view.timestamp_us)
    corners = compute_box_corners(positions[agent], float(yaws[agent]), scene.agents.size[agent])
    corners = to_camera(corners, view.global_T_ego, camera)
    points = [corner for corner in corners if corner[2] >= 0.1]
    for one, other in ((corners[first], corners[second]) for first, second in BOX_EDGES):
        if (one[2] < 0.1) != (other[2] < 0.1):
            share = (0.1 - one[2]) / (other[2] - one[2])
            points.append((1.0 - share) * one + share * other)
    if not points:
        return None
    pixels = np.array(points) @ camera.intrinsic.T
    hull = shapely.MultiPoint(pixels[:, :2] / pixels[:, 2:]).convex_hull
    inside = hull.intersection(shapely.box(0, 0, *size))
    return inside if isinstance(inside, shapely.Polygon) and inside.area > 0 else None


@pytest.mark.parametrize(("ahead", "left"), [(12.0, 2.0), (4.0, 3.0), (-9.0, -3.0), (1.0, 2.6)])
def test_edges_are_the_outline_of_the_box(ahead: float, left: float) -> None:
    car = Car(50.0 + ahead, 198.25 + left, 0.0, 0.3)
    scene = with_adversary(short_scene(cars=(car, Car(80.0, 190.0)), ego_speed=0.0))
    cells = lay_out_cameras({camera.name: camera for camera in scene.cameras}, 320)
    views = {camera.name: view_of(scene, camera.name, 18) for camera in scene.cameras}
    found = project_adversary_edges(scene, cells, views)
    assert found
    for cell in cells:
        outline = outline_of_adversary(scene, views[cell.name], (cell.width, cell.height))
        assert (cell.name in found) == (outline is not None)
        if outline is None:
            continue
        ends = np.array(found[cell.name]).reshape(-1, 2) - [cell.left, cell.top]
        assert (ends >= 0).all() and (ends <= [cell.width, cell.height]).all()
        hull = outline.buffer(0.15)
        assert all(hull.covers(shapely.Point(end)) for end in ends)
        # Nothing of the outline is missing but where it runs along the border of the cell.
        border = shapely.box(0, 0, cell.width, cell.height).exterior.buffer(0.1)
        rest = outline.exterior.difference(border)
        lines = shapely.MultiLineString([line.tolist() for line in ends.reshape(-1, 2, 2)])
        assert rest.difference(lines.buffer(0.3)).length < 1.0


def test_cameras_stand_as_in_a_car_and_strangers_below() -> None:
    scene = short_scene(seconds=1.0)
    cameras = {camera.name: camera for camera in scene.cameras if camera.name != "CAM_BACK"}
    odd = replace(scene.cameras[0], name="ROOF", width=200, height=400)
    cells = {cell.name: cell for cell in lay_out_cameras({**cameras, "ROOF": odd}, 320)}
    assert [cell.name for cell in cells.values()][:3] == list(CAMERA_GRID[0])
    assert cells["CAM_BACK_RIGHT"].left == cells["CAM_BACK_LEFT"].width == 320
    roof = cells["ROOF"]
    assert (roof.left, roof.top, roof.width, roof.height) == (0, 360, 200, 400)
    assert lay_out_cameras({}, 320) == ()
    tall = replace(scene.cameras[0], width=10, height=20_000)
    with pytest.raises(InputError, match="too large for WebP"):
        draw_mosaic(lay_out_cameras({"CAM_FRONT": tall}, 10), {})


def taken(scene: Scene, name: str, times_us: Sequence[int]) -> tuple[CameraView, ...]:
    view = view_of(scene, name, 0)
    picture = np.full((18, 32, 3), 200, np.uint8)
    return tuple(
        replace(view, path=Path(f"{name}-{time}"), timestamp_us=time, load=lambda: picture) for time in times_us
    )


def test_frames_meet_the_images_of_clocks_of_their_own() -> None:
    scene = short_scene(seconds=1.5)
    samples, times = scene.timestamps_us[scene.keyframes], scene.timestamps_us
    cameras = ("CAM_FRONT", "CAM_BACK")
    # As in nuScenes: the front camera is 43 ms early, the other one on time; one of its sweeps is lost, and so is its
    # image of the second sample.
    keyframes = {
        "CAM_FRONT": taken(scene, "CAM_FRONT", (samples - 43_000).tolist()),
        "CAM_BACK": taken(scene, "CAM_BACK", samples.tolist()),
    }
    sweeps = {
        name: taken(scene, name, [time - early for frame, time in enumerate(times) if frame % 6 and frame not in lost])
        for name, early, lost in zip(cameras, (43_000, 0), ((), (9,)), strict=True)
    }
    keyframes["CAM_BACK"] = (keyframes["CAM_BACK"][0], keyframes["CAM_BACK"][2])
    found = select_pictured_frames(scene, keyframes, sweeps)
    assert [each.frame for each in found] == [frame for frame in range(13) if frame != 9] + [13, 14, 15, 16, 17]
    by_frame = {each.frame: each.views for each in found}
    assert set(by_frame[6]) == {"CAM_FRONT"}
    assert by_frame[6]["CAM_FRONT"].timestamp_us == samples[1] - 43_000
    assert {view.timestamp_us for view in by_frame[8].values()} == {times[8], times[8] - 43_000}
    assert [each.frame for each in select_pictured_frames(scene, keyframes, {})] == [0, 6, 12]
    cells = lay_out_cameras({name: view_of(scene, name, 0).camera for name in cameras}, 32)
    picture = cv2.imdecode(np.frombuffer(draw_mosaic(cells, by_frame[6]), np.uint8), cv2.IMREAD_COLOR)
    front, back = ({cell.name: cell for cell in cells}[name] for name in cameras)
    assert abs(int(np.median(picture[: front.height])) - 200) < 5
    assert np.median(picture[back.top :]) < 5


near_the_picture = st.floats(-50, 150)


@settings(max_examples=40, deadline=None)
@example(0.0, 3e-291, -4e-255, 1.0)
@given(near_the_picture, near_the_picture, near_the_picture, near_the_picture)
def test_segments_are_cut_as_geometry_says(x1: float, y1: float, x2: float, y2: float) -> None:
    segment = np.array([[x1, y1], [x2, y2]])
    found = clip_segment(segment, 100, 60)
    expected = shapely.LineString(segment).intersection(shapely.box(0, 0, 100, 60))
    if found is None:
        # What lies along a border, to within rounding, may be in or out.
        inside = shapely.box(1e-6, 1e-6, 100 - 1e-6, 60 - 1e-6)
        assert shapely.LineString(segment).intersection(inside).length < 0.2
    else:
        assert shapely.LineString(found).hausdorff_distance(expected) < 1e-6


anything = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=40, deadline=None)
@given(anything, anything, anything, anything)
def test_segments_that_are_none_are_not_drawn(x1: float, y1: float, x2: float, y2: float) -> None:
    with np.errstate(all="ignore"):
        found = clip_segment(np.array([[x1, y1], [x2, y2]]), 100, 60)
    assert found is None or (np.isfinite(found).all() and (found >= 0).all() and (found <= [100, 60]).all())
