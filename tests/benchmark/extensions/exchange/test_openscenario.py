"""Scenes as OpenSCENARIO: valid by the official schema, and every track stands in the file."""

import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.datasets.scenario_map import ExchangedScene
from benchmark.datasets.scenarionet import read_scenarionet
from benchmark.errors import InputError
from benchmark.extensions.exchange.openscenario import encode_openscenario, export_openscenario, find_stretches
from benchmark.geometry import Bools, Floats
from benchmark.scene import Scene
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.datasets.test_scenarionet import FILES
from tests.benchmark.extensions.exchange.wild_scenes import wild_scene
from tests.benchmark.fake_data import town_of_two
from tests.generation.labels.recorded_roads import recorded, write_source
from tests.hand_made import Car, scene_on_straight_road


@settings(max_examples=25, deadline=None)
@given(st.lists(st.booleans(), max_size=12))
def test_stretches_are_all_that_is_there(flags: list[bool]) -> None:
    found = np.zeros(len(flags), np.bool_)
    ends = [-2]
    for first, last in find_stretches(np.array(flags, np.bool_)):
        assert ends[-1] + 1 < first <= last
        found[first : last + 1] = True
        ends.append(last)
    assert found.tolist() == flags


def test_without_the_package_one_sentence_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scenariogeneration", None)
    with pytest.raises(InputError, match=r"install it with: pip install 'challenger-bench\[openscenario\]'"):
        export_openscenario(town_of_two(), ["scene-9901"], tmp_path, workers=1)
    assert not list(tmp_path.iterdir())


xosc = pytest.importorskip("scenariogeneration.xosc", reason="the extra openscenario is not installed")


def tracks_in(root: ElementTree.Element) -> dict[str, list[Floats]]:
    """For each object, rows of seconds, x, y, z, heading of each of its stretches of time."""
    found: dict[str, list[Floats]] = {}
    for group in root.iter("ManeuverGroup"):
        actor = group.find("Actors/EntityRef")
        assert actor is not None
        rows = []
        for line in group.iter("Polyline"):
            vertices = []
            for vertex in line.iter("Vertex"):
                place = vertex.find("Position/WorldPosition")
                assert place is not None
                vertices.append([vertex.attrib["time"], *(place.attrib[name] for name in "xyzh")])
            rows.append(np.array(vertices, np.float64))
        found[actor.attrib["entityRef"]] = rows
    return found


def require_same(scene: Scene, data: bytes) -> None:
    root = ElementTree.fromstring(data)
    tracks = tracks_in(root)
    ego = np.column_stack([scene.seconds, scene.ego.position, scene.ego.yaw])
    assert np.array_equal(tracks["ego"][0], ego) and set(tracks) == {"ego", *scene.agents.ids}
    for row, name in enumerate(scene.agents.ids):
        place, ground = scene.agents.position[row], scene.agents.position[row, :, 2] - scene.agents.size[row, 2] / 2
        expected = np.column_stack([scene.seconds, place[:, :2], ground, scene.agents.yaw[row]])
        longer = [(first, last) for first, last in find_stretches(scene.agents.valid[row]) if last > first]
        assert len(tracks[name]) == len(longer)
        for (first, last), vertices in zip(longer, tracks[name], strict=True):
            assert np.array_equal(vertices, expected[first : last + 1])
    said = {entry.attrib["name"]: entry.attrib["value"] for entry in root.iterfind("FileHeader/Properties/Property")}
    assert said["adversaries"].split() == list(scene.adversaries)
    for entity in root.iter("ScenarioObject"):
        marks = {entry.attrib["name"]: entry.attrib["value"] for entry in entity.iter("Property")}
        assert (marks["adversary"] == "true") == (entity.attrib["name"] in scene.adversaries)
        box = entity.find("*/BoundingBox/Dimensions")
        assert box is not None
        if entity.attrib["name"] != "ego":
            size = scene.agents.size[scene.agents.ids.index(entity.attrib["name"])]
            assert [float(box.attrib[side]) for side in ("length", "width", "height")] == size.tolist()


@pytest.mark.parametrize("seed", range(2))
def test_every_track_stands_in_the_file_and_the_official_schema_accepts_it(seed: int, tmp_path: Path) -> None:
    from scenariogeneration.xosc.xosc_reader import validate_schema

    scene = wild_scene(seed)
    data = encode_openscenario(ExchangedScene(scene, "scene-0061"))
    require_same(scene, data)
    assert encode_openscenario(ExchangedScene(scene, "scene-0061")) == data
    path = tmp_path / "scene.xosc"
    path.write_bytes(data)
    assert validate_schema(ElementTree.parse(path))
    broken = ElementTree.fromstring(data.replace(b"Entities>", b"Others>"))
    assert not validate_schema(ElementTree.ElementTree(broken))


def test_the_package_reads_it_back(tmp_path: Path) -> None:
    scene = scene_on_straight_road((Car(80.0, 198.25, 8.0), Car(60.0, 194.75, 1.0, 0.5, "human.pedestrian.adult")))
    scene = replace(scene, adversaries=scene.agents.ids[:1])
    path = tmp_path / "scene.xosc"
    path.write_bytes(encode_openscenario(ExchangedScene(scene, scene.name)))
    read = xosc.ParseOpenScenario(str(path))
    objects = {each.name: each.entityobject for each in read.entities.scenario_objects}
    assert list(objects) == ["ego", *scene.agents.ids]
    assert [type(each).__name__ for each in objects.values()] == ["Vehicle", "Vehicle", "Pedestrian"]
    again = ElementTree.tostring(read.get_element())
    assert np.array_equal(tracks_in(ElementTree.fromstring(again))["ego"][0][:, 1], scene.ego.position[:, 0])


def test_who_comes_and_goes_is_added_and_deleted() -> None:
    scene = scene_on_straight_road((Car(80.0, 198.25, 8.0),))
    valid: Bools = scene.agents.valid.copy()
    valid[0, :6], valid[0, 12], valid[0, 40:] = False, False, False
    scene = replace(scene, agents=replace(scene.agents, valid=valid))
    root = ElementTree.fromstring(encode_openscenario(ExchangedScene(scene, scene.name)))
    name = scene.agents.ids[0]
    for path, expected in (("GlobalAction/EntityAction", name), ("Private", "ego")):
        (each,) = root.iterfind(f"Storyboard/Init/Actions/{path}")
        assert each.attrib["entityRef"] == expected
    events = {
        event.attrib["name"].removeprefix(f"{name} "): float(trigger.attrib["value"])
        for event in root.iter("Event")
        for trigger in event.iter("SimulationTimeCondition")
        if event.attrib["name"].startswith(name)
    }
    seconds = scene.seconds
    assert events == {
        "comes 0": seconds[6], "drives 0": seconds[6], "goes 0": seconds[12],
        "comes 1": seconds[13], "drives 1": seconds[13], "goes 1": seconds[40],
    }  # fmt: skip


@pytest.mark.path
def test_the_command_writes_a_file_a_scene(tmp_path: Path) -> None:
    data = write_source(tmp_path / "root", recorded("scene-9901"), recorded("scene-9902"))
    done = run_here("data", "export", "openscenario", data.root, "--to", tmp_path / "to", "--workers", "1")
    assert done.code == 0 and done.out.startswith("2 scenes in"), done.err
    assert sorted(path.name for path in (tmp_path / "to").iterdir()) == ["scene-9901.xosc", "scene-9902.xosc"]
    for path in FILES[3:4]:
        scene = read_scenarionet(path)
        require_same(scene, encode_openscenario(ExchangedScene(scene, scene.name)))
    require_same(data.scene("scene-9902"), (tmp_path / "to" / "scene-9902.xosc").read_bytes())
    done = run_here("data", "export", "openscenario", data.root, "--limit", "1", "--to", tmp_path / "to")
    assert done.code == 2 and "holds scene-9902.xosc" in done.err
