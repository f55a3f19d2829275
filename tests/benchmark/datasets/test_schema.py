"""The description of the tables: quick and slow look agree, and what is written here or was recorded conforms."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.scenarionet import find_scenarionet, read_scenarionet
from benchmark.datasets.schema import LINKS, SCHEMA, FaultList, check_rows
from benchmark.datasets.schema.check import check_tables
from benchmark.datasets.schema.tables import ValueKind, is_file_inside, is_file_name
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.generation.nuscenes_writer.written_roots import short_scene, with_adversary, write_root
from tests.hand_made import Car, scene_on_straight_road

SHARED = Path(__file__).resolve().parents[4] / "shared" / "data"
FIELDS = {(table, name): field for table, fields in SCHEMA.items() for name, field in fields.items()}
KINDS = {id(field.kind): field.kind for field in FIELDS.values()}
NUMBERS = st.floats() | st.integers() | st.integers(946_684_800_000_000, 4_102_444_800_000_000) | st.booleans()
UNIT = st.sampled_from([[1.0, 0.0, 0.0, 0.0], [0, 1, 0, 0], [0.6, 0.0, 0.0, -0.8]])
VALUES = st.one_of(
    NUMBERS, st.none(), st.text(max_size=5), st.text("ab/.:\\é", max_size=6),
    st.lists(NUMBERS, min_size=3, max_size=4), st.lists(st.floats(0.1, 100.0), min_size=3, max_size=3), UNIT,
    st.just([]), st.just([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1]]), st.lists(st.text(min_size=1, max_size=3), max_size=2),
)  # fmt: skip


def test_all_tables_are_described_and_every_link_leads_into_one() -> None:
    assert set(SCHEMA) == set(NUSCENES_TABLES)
    assert {link.target for link in LINKS} <= set(SCHEMA)
    assert all("token" in fields for fields in SCHEMA.values())


@settings(max_examples=100, deadline=None)
@given(kind=st.sampled_from(list(KINDS.values())), values=st.lists(VALUES, min_size=1, max_size=3))
def test_a_column_that_passes_the_quick_look_holds_only_what_it_may(kind: ValueKind, values: list[Any]) -> None:
    alone = [kind.holds(value) for value in values]
    # Links are looked up, so the quick look leaves it to that whether they are tokens.
    if kind.column(values) and "token" not in kind.words:
        assert all(alone), values
    assert len({type(value) for value in alone}) == 1 and isinstance(alone[0], bool)


@given(st.text() | st.sampled_from(["con", "LPT9.txt", "a.", ".a", "~", "-", "é" * 50, "é" * 51]))
def test_names_can_be_files(name: str) -> None:
    if is_file_name(name):
        assert Path(name).name == name and name.encode().decode() == name and len(name.encode()) <= 100
        assert not set(name) & set('<>:"/\\|?*\0\n')
        assert name.split(".")[0].upper() not in {"CON", "NUL", "COM1", "LPT9"}


@given(st.text("ab./\\:"))
def test_file_names_stay_inside(name: str) -> None:
    if is_file_inside(name):
        assert Path("/root", name).resolve().is_relative_to("/root") and Path(name).parts


def errors(root: Path) -> list[str]:
    return [f"{fault.table}: {fault.sentence}" for fault in check_tables(root) if fault.severity == "error"]


@settings(max_examples=5, deadline=None)
@given(data=st.data())
def test_what_the_writer_writes_conforms(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    number = st.floats(-100.0, 100.0, width=32)
    car = st.builds(
        Car, x=number, y=number, speed=st.floats(0.0, 40.0), yaw=st.floats(-10.0, 10.0),
        category=st.sampled_from(["vehicle.car", "vehicle.truck", "human.pedestrian.adult"]),
        size=st.tuples(*[st.floats(0.1, 30.0)] * 3),
    )  # fmt: skip
    cars = tuple(data.draw(st.lists(car, min_size=1, max_size=4)))
    scene = scene_on_straight_road(cars, ego_x=data.draw(number), ego_speed=data.draw(st.floats(0, 40)), seconds=1.5)
    frames = data.draw(st.sampled_from(["all", "keyframes"]))
    root = tmp_path_factory.mktemp("written")
    scene = with_adversary(scene) if cars[0].category == "vehicle.car" else scene
    write_root(root, [scene], renderer=None, frames=frames)
    assert not errors(root)
    assert NuScenesData.open(root).scene(scene.name).name == scene.name


def test_recorded_scenes_conform(tmp_path: Path) -> None:
    if not SHARED.is_dir():
        pytest.skip("the shared data is not beside the repository")
    scenes = [read_scenarionet(path) for path in find_scenarionet(SHARED / "scenes")[:1]]
    write_root(tmp_path, scenes, renderer=None, frames="all")
    assert not errors(tmp_path)
    data = NuScenesData.open(tmp_path)
    for scene in scenes:
        assert np.allclose(data.scene(scene.name).ego.position[0], scene.ego.position[0])


def test_recorded_rows_conform() -> None:
    """Real rows of nuScenes, cut down: the fields that are there are as they must be."""
    folder = SHARED / "nuscenes" / "scene0061_tables_v1.0-test"
    if not folder.is_dir():
        pytest.skip("the shared data is not beside the repository")
    for path in sorted(folder.glob("*.json")):
        for row in json.loads(path.read_text()):
            for name, field in SCHEMA[path.stem].items():
                assert name not in row or field.kind.holds(row[name]), (path.stem, name, row[name])


def test_what_the_published_data_set_does_is_no_error(tmp_path: Path) -> None:
    """Suffixed names, copied intrinsics, one visibility, one point a box, yaw alone, one attribute."""
    made = TinyRoot.of(tmp_path, [short_scene(seconds=2.0)], cameras=("CAM_FRONT", "CAM_BACK"))
    made.tables["scene"][0]["name"] = "scene-9901-1a2b3c"
    front = made.row("calibrated_sensor", "scene-9901-CAM_FRONT")["camera_intrinsic"]
    made.row("calibrated_sensor", "scene-9901-CAM_BACK")["camera_intrinsic"] = front
    made.tables["visibility"].append({"token": "3", "level": "v60-80", "description": ""})
    for row in made.tables["sample_annotation"]:
        row |= {"visibility_token": "3", "num_lidar_pts": 1, "num_radar_pts": 1}
    made.write()
    # The images of this root are another matter.
    faults = [fault for fault in check_tables(tmp_path) if "missing" not in fault.sentence]
    assert {fault.severity for fault in faults} == {"warning"}
    assert any("as if it were copied" in fault.sentence for fault in faults)
    assert len(NuScenesData.open(tmp_path).truth("scene-9901-1a2b3c")) == 4


def test_only_doubtful_columns_are_looked_at_twice() -> None:
    faults = FaultList()
    rows = [{"token": f"é{index}", "level": "a"} for index in range(3)] + [{"token": "b", "level": 3}]
    assert list(check_rows("visibility", rows, faults).values()) == [frozenset({"level"})]
    assert [fault.sentence for fault in faults.told()] == ["level is 3, it must be text"]
