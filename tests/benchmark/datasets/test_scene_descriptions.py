"""Recordings in words: what they say of place and light, and what can be seen of traffic and road."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.scenarionet import read_scenarionet
from benchmark.datasets.scene_descriptions import describe_place_and_light, describe_traffic_and_road
from benchmark.scene import Conditions
from tests.benchmark.datasets.test_scenarionet import FILES, needs_shared, recording, track, write
from tests.hand_made import Car, scene_on_straight_road


@pytest.mark.parametrize(
    ("metadata", "words"),
    [
        ({}, []),
        ({"map": "boston-seaport", "date": "2018-08-28"}, []),
        ({"map": "us-nv-las-vegas-strip"}, ["Las Vegas"]),
        ({"map": "PIT", "time_of_day": "Night", "weather": "rain"}, ["Pittsburgh", "night", "rain"]),
        ({"time_of_day": "Dawn/Dusk"}, ["dusk"]),
        ({"time_of_day": "ignore the above", "map": "night", "weather": 3}, []),
        ({"log_name": "n015-2018-07-24-11-22-45+0800"}, ["daytime"]),
        ({"log_name": "n008-2018-11-21-21-10-00-0400"}, ["night"]),
        ({"log_name": "n008-2018-11-21-18-10-00-0400"}, []),
        ({"log_name": "2021.05.12.22.00.38_veh-35_01008_01518"}, []),
    ],
)
def test_place_and_light_are_said_where_they_are_known(metadata: dict[str, Any], words: list[str]) -> None:
    assert describe_place_and_light(metadata) == words


def test_an_imported_recording_is_described(tmp_path: Path) -> None:
    scene = read_scenarionet(write(tmp_path, recording()))
    assert scene.description == "Some traffic, bicycle, pedestrians"
    value = recording()
    value["metadata"] |= {"time_of_day": "Night", "map": "us-pa-pittsburgh-hazelwood"}
    value["tracks"] |= {f"p{number}": track("VEHICLE", -290.0 + number, 9.0) for number in range(3)}
    night = read_scenarionet(write(tmp_path, value))
    assert night.description.startswith("Pittsburgh, night, some traffic, bicycle, parked cars")
    assert night.look is Conditions.NIGHT and scene.look is Conditions.DAY


def test_turns_and_standing_are_seen_in_the_ego_s_way() -> None:
    straight = scene_on_straight_road((Car(60.0, 194.75, 10.0),))
    assert not {"turn left", "turn right", "waiting"} & set(describe_traffic_and_road(straight))
    half = np.linspace(0.0, np.pi / 4, len(straight.ego.position))
    for sign, word in ((1, "turn left"), (-1, "turn right")):
        rotation = np.stack([np.cos(half), 0 * half, 0 * half, sign * np.sin(half)], axis=1)
        assert word in describe_traffic_and_road(replace(straight, ego=replace(straight.ego, rotation=rotation)))
    still = replace(straight.ego, position=np.repeat(straight.ego.position[:1], len(straight.ego.position), axis=0))
    assert "waiting" in describe_traffic_and_road(replace(straight, ego=still))


@needs_shared
def test_real_recordings_have_descriptions_of_their_own() -> None:
    said = {read_scenarionet(path).description for path in FILES}
    assert len(said) == len(FILES)
    for words in said:
        assert "ScenarioNet" not in words and Conditions.from_description(words) is Conditions.DAY, (
            "their files say no light"
        )
