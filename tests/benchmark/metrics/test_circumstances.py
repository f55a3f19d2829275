"""Where the recorded car is at each sample and how fast, from tracks and map; what records hold of it."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import shapely
from shapely.geometry import MultiPolygon

from benchmark.evaluation import evaluate
from benchmark.metrics.places import PlaceClassifier, PlaceKind, classify_place, read_sample_contexts
from benchmark.records.row_schema import PlaceName
from benchmark.records.run import load_record
from benchmark.records.run_schema import LightName
from benchmark.road_map import RoadMap
from benchmark.scene import Conditions
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Straight
from tests.hand_made import scene_on_straight_road, straight_road


def test_records_know_every_place_and_every_light() -> None:
    assert get_args(PlaceName) == tuple(place.value for place in PlaceKind)
    assert get_args(LightName) == tuple(look.value for look in Conditions)


def test_a_car_that_crosses_a_junction_is_in_it_from_its_middle_on() -> None:
    scene, junction = scene_on_straight_road(ego_speed=8.0), shapely.box(65.0, 190.0, 85.0, 210.0)
    segments = {**scene.road_map.road_segments, "junction": junction}
    mapped = replace(scene.road_map, road_segments=segments, intersections=frozenset({"junction"}))
    found = read_sample_contexts(replace(scene, road_map=mapped))
    middles = scene.ego.boxes[scene.keyframes, 0]
    expected = [PlaceKind.JUNCTION if 65.0 <= x <= 85.0 else PlaceKind.STRAIGHT for x in middles]
    assert [one.place for one in found] == expected and PlaceKind.JUNCTION in expected


def test_speed_is_that_of_the_recording_and_needs_no_can_bus() -> None:
    assert {one.speed_m_s for one in read_sample_contexts(scene_on_straight_road(ego_speed=7.5))} == {7.5}
    scene = scene_on_straight_road(ego_speed=0.0)
    # Braking at 1 m/s^2 from 8 m/s: a parabola fits it exactly.
    along = 50.0 + 8.0 * scene.seconds - 0.5 * scene.seconds**2
    position = np.column_stack([along, scene.ego.position[:, 1:]])
    braking = replace(scene, ego=replace(scene.ego, position=position))
    speeds = [one.speed_m_s for one in read_sample_contexts(braking)]
    assert speeds == pytest.approx(8.0 - scene.seconds[scene.keyframes], abs=2e-3)


def test_a_map_that_is_asked_often_answers_as_one_that_is_asked_once_and_without_a_map_all_is_unknown() -> None:
    road_map, scene = straight_road(), scene_on_straight_road()
    places, boxes = PlaceClassifier(road_map), scene.ego.boxes[::7]
    assert [places.of(box, box) for box in boxes] == [classify_place(road_map, box, box) for box in boxes]
    unmapped = replace(scene, road_map=RoadMap("nowhere", MultiPolygon()))
    assert {one.place for one in read_sample_contexts(unmapped)} == {PlaceKind.UNKNOWN}


def test_rows_say_where_their_samples_are_and_read_back_so(tmp_path: Path) -> None:
    data = town_of_two()
    record = evaluate(data, "val", Straight(), tmp_path)
    expected = [one for name in data.scene_names() for one in read_sample_contexts(data.scene(name))]
    assert [row.place for row in record.rows] == [one.place.value for one in expected]
    assert [row.speed_m_s for row in record.rows] == [one.speed_m_s for one in expected]
    assert load_record(record.directory).rows == record.rows
    assert {tuple(facts.light or ()) for facts in record.run.scene_facts.values()} == {("day",)}
