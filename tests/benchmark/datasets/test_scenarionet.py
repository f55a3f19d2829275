import os
import pickle
from collections import OrderedDict, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, OFFICIAL_LOCATIONS
from benchmark.datasets.sample_truth import compute_truth
from benchmark.datasets.scenarionet import find_scenarionet, read_scenarionet
from benchmark.errors import InputError
from benchmark.geometry import to_global
from benchmark.road_map import DividerKind
from benchmark.untrusted.children import read_pickle

SHARED = Path(__file__).resolve().parents[4] / "shared"
FILES = tuple(sorted((SHARED / "data" / "scenes").glob("sd_*.pkl")))
needs_shared = pytest.mark.skipif(not FILES, reason="no shared material beside the repository")


def track(
    kind: str, x: Any, y: float, *, z: float = 0.8, steps: int = 31, detailed: str | None = None, **state: Any
) -> dict[str, Any]:
    column = np.ones((steps, 1))
    return {
        "type": kind, "metadata": {"type": detailed or kind},
        "state": {
            "position": np.column_stack([np.broadcast_to(x, steps), np.full(steps, y), np.full(steps, z)]),
            "heading": np.zeros(steps), "velocity": np.zeros((steps, 2)), "valid": np.ones(steps),
            "length": 4.6 * column, "width": 1.9 * column, "height": 1.6 * column, **state,
        },
    }  # fmt: skip


def recording(**changes: Any) -> dict[str, Any]:
    """Three seconds at 10 Hz: the ego at 10 m/s, a car, a pedestrian and a cyclist on a road of two lanes."""
    steps = 31
    seconds = np.arange(steps) * 0.1
    lane = {"type": "LANE_SURFACE_STREET", "entry_lanes": [], "exit_lanes": ["b"], "width": np.full((3, 2), 2.0)}
    value: dict[str, Any] = {
        "id": "0a1b2c",
        "version": "waymo_v1.2",
        "length": steps,
        "metadata": {"dataset": "waymo", "ts": seconds, "sdc_id": "0", "map": None, "coordinate": "right-handed"},
        "tracks": {
            "0": track("VEHICLE", -300.0 + 10 * seconds, 0.0, z=200.8),
            "1": track("VEHICLE", -280.0 + 5 * seconds, 0.0, z=200.8),
            "2": track("PEDESTRIAN", -290.0, 5.0, z=200.9),
            "3": track("CYCLIST", -290.0, -5.0, z=200.9),
        },
        "map_features": {
            "a": {**lane, "polyline": np.array([[-400.0, 0, 200], [-300, 0, 200], [-280, 0, 200]])},
            "b": {**lane, "exit_lanes": [], "polyline": np.array([[-280.0, 0, 200], [-250, 0, 200], [-200, 0, 200]])},
            "line": {"type": "ROAD_LINE_BROKEN_SINGLE_WHITE", "polyline": np.array([[-400.0, 2, 200], [-200, 2, 200]])},
            "middle": {"type": "ROAD_LINE_SOLID_DOUBLE_YELLOW", "polyline": np.array([[-400.0, -2, 0], [-200, -2, 0]])},
            "zebra": {"type": "CROSSWALK", "polygon": [[-250, -2, 0], [-246, -2, 0], [-246, 2, 0], [-250, 2, 0]]},
            "stop": {"type": "STOP_SIGN", "position": [0, 0, 0], "lane": ["a"]},
        },
        "dynamic_map_states": {},
    }
    return {**value, **changes}


def write(folder: Path, value: Any, name: str = "sd_test.pkl") -> Path:
    path = folder / name
    path.write_bytes(pickle.dumps(value))
    return path


def test_a_recording_of_another_source_becomes_a_scene(tmp_path: Path) -> None:
    scene = read_scenarionet(write(tmp_path, recording()))
    assert scene.keyframes.tolist() == [0, 6, 12, 18, 24, 30, 36] and len(scene.timestamps_us) == 37
    assert np.allclose(np.diff(scene.timestamps_us), 1e6 / 12, atol=1)
    assert scene.agents.categories == ("vehicle.car", "human.pedestrian.adult", "vehicle.bicycle")
    x, y, _ = scene.ego.position.T
    assert np.allclose(np.diff(x), 10 / 12)
    assert np.allclose(scene.agents.position[0, 0, :2] - [x[0], y[0]], [20.0 + EGO_CENTER_FROM_REAR_AXLE_M, 0.0])
    assert np.allclose(scene.agents.position[:, :, 2], [[0.8], [0.9], [0.9]])
    assert np.allclose(scene.ego.position[:, 2], 0)
    assert scene.annotations.num_lidar_pts.tolist() == [[1] * 7] * 3
    assert scene.road_map.location in OFFICIAL_LOCATIONS and scene.name.startswith("scene-")
    assert 2000 <= int(scene.name[-4:]) <= 9999


def test_negative_coordinates_are_shifted_map_and_all(tmp_path: Path) -> None:
    scene = read_scenarionet(write(tmp_path, recording()))
    road_map = scene.road_map
    low = np.array(road_map.drivable_area.bounds[:2])
    assert (low > 0).all() and (scene.agents.position[..., :2] > 0).all()
    assert road_map.is_drivable(scene.ego.position[:, :2]).all()
    assert road_map.is_drivable(scene.agents.position[0, :, :2]).all()
    assert not road_map.is_drivable(scene.agents.position[1:, :, :2]).any()
    assert road_map.canvas_m[0] > road_map.drivable_area.bounds[2]
    lane = next(iter(road_map.lanes.values()))
    assert lane.centerline[0, 1] == pytest.approx(scene.ego.position[0, 1])


def test_lanes_and_lines_are_read(tmp_path: Path) -> None:
    road_map = read_scenarionet(write(tmp_path, recording())).road_map
    assert road_map.lanes["a"].successors == ("b",) and road_map.lanes["b"].predecessors == ("a",)
    kinds = {line.identifier: (line.kind, line.between_directions) for line in road_map.dividers}
    assert kinds == {"line": (DividerKind.DASHED_WHITE, False), "middle": (DividerKind.SOLID_YELLOW, True)}
    assert set(road_map.ped_crossings) == {"zebra"} and not any(lane.is_connector for lane in road_map.lanes.values())
    assert road_map.drivable_area.area == pytest.approx(200 * 4, rel=0.01)


def test_lanes_without_links_are_joined_where_they_touch(tmp_path: Path) -> None:
    value = recording()
    for name in ("a", "b"):
        del value["map_features"][name]["entry_lanes"], value["map_features"][name]["exit_lanes"]
    lanes = read_scenarionet(write(tmp_path, value)).road_map.lanes
    assert lanes["a"].successors == ("b",) and lanes["b"].predecessors == ("a",) and lanes["b"].successors == ()


def test_an_object_is_there_only_where_it_was_seen(tmp_path: Path) -> None:
    value = recording()
    valid = np.ones(31)
    valid[8:16] = 0
    value["tracks"]["1"]["state"]["valid"] = valid
    value["tracks"]["1"]["state"]["position"][8:16] = np.nan
    flash = np.zeros(31)
    flash[7] = 1
    value["tracks"]["2"]["state"]["valid"] = flash
    scene = read_scenarionet(write(tmp_path, value))
    assert scene.agents.ids == ("1", "3")
    seconds = np.arange(37) / 12
    assert np.array_equal(scene.agents.valid[0], (seconds < 0.7 + 1e-9) | (seconds > 1.6 - 1e-9))
    assert np.isfinite(scene.agents.position).all()
    assert scene.annotations.valid[0].tolist() == [True, True, False, False, True, True, True]


def test_long_vehicles_are_lorries_and_buses(tmp_path: Path) -> None:
    value = recording()
    for name, length in (("8", 8.0), ("9", 12.0)):
        value["tracks"][name] = track("VEHICLE", -290.0, 9.0, length=np.full(31, length))
    value["tracks"]["10"] = track("TRAFFIC_CONE", -290.0, 9.0, detailed="movable_object.trafficcone")
    value["tracks"]["11"] = track("VEHICLE", -290.0, 9.0, detailed="vehicle.emergency.police")
    categories = read_scenarionet(write(tmp_path, value)).agents.categories
    assert categories[3:] == (
        "vehicle.truck", "vehicle.bus.rigid", "movable_object.trafficcone", "vehicle.emergency.police",
    )  # fmt: skip


def test_the_same_file_gives_the_same_scene(tmp_path: Path) -> None:
    path = write(tmp_path, recording())
    first, second = read_scenarionet(path), read_scenarionet(path)
    assert (first.name, first.token, first.agents.ids) == (second.name, second.token, second.agents.ids)
    assert np.array_equal(first.timestamps_us, second.timestamps_us)
    assert first.road_map.drivable_area.wkb == second.road_map.drivable_area.wkb


def damaged(**changes: Any) -> dict[str, Any]:
    value = recording()
    for path, new in changes.items():
        *parents, last = path.split("__")
        target = value
        for parent in parents:
            target = target[parent]
        target[last] = new
    return value


NAN_POSITION = np.full((31, 3), np.nan)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1, 2], "is not a ScenarioNet scenario"),
        ({"id": "x"}, "it needs the keys"),
        (damaged(metadata__sdc_id="7"), "sdc_id '7' names no track"),
        (damaged(metadata__ts=np.zeros(31)), "increasing finite times"),
        (damaged(metadata__ts=np.arange(30) * 0.1), "must be 31 increasing"),
        (damaged(metadata__ts=np.arange(31) * 100.0), "must be in seconds"),
        (damaged(metadata={}), "no usable list of times"),
        (damaged(tracks__1__state__position=NAN_POSITION), "track 1 has a pose that is not finite at step 0"),
        (damaged(tracks__0__state__position=NAN_POSITION), "track 0 has a pose that is not finite"),
        (damaged(tracks__1__state__heading=np.zeros(30)), "track 1 needs type and state"),
        (damaged(tracks__1__state__position=np.zeros((31, 4))), "position has shape"),
        (damaged(tracks__1__state__length=np.zeros(31)), "sizes must be positive"),
        (damaged(tracks__0__state__valid=np.arange(31) > 3), "ego is absent at step 0"),
        (damaged(map_features__a__polyline=np.array([[0, np.nan], [1, 1]])), "coordinate that is not finite"),
        (damaged(map_features__a=3), "map feature a has no type"),
        (damaged(map_features__a__polyline="north"), "is not a list of points"),
        (
            damaged(length=5, metadata__ts=np.arange(5) * 0.1, tracks={"0": track("VEHICLE", 0.0, 0.0, steps=5)}),
            "two keyframes",
        ),
    ],
)  # fmt: skip
def test_broken_recordings_are_refused(tmp_path: Path, value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_scenarionet(write(tmp_path, value))
    assert "sd_test.pkl" in str(caught.value)


class Call:
    """Pickles as a call, as a stranger may write it."""

    def __init__(self, function: Any, *arguments: Any, state: Any = None) -> None:
        self._call = (function, arguments, state)

    def __reduce__(self) -> tuple[Any, ...]:
        return self._call


@pytest.mark.parametrize(
    ("payload", "name"),
    [
        (Call(os.system, "touch pwned"), r"posix\.system"),
        (Call(getattr, dict, "fromkeys"), r"builtins\.getattr"),
        (Path("x"), "pathlib"),
        (np.sin, "numpy"),
    ],
)
def test_a_pickle_that_could_run_code_is_refused(
    tmp_path: Path, payload: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, recording(extra=payload))
    with pytest.raises(InputError, match=f"is refused: its pickle uses {name}"):
        read_scenarionet(path)
    assert not (tmp_path / "pwned").exists()


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_arrays_and_containers_of_any_protocol_are_read(tmp_path: Path, protocol: int) -> None:
    value: dict[str, Any] = {
        "array": np.arange(6.0).reshape(2, 3), "scalar": np.float32(3), "set": {1}, "frozen": frozenset({2}),
        "ordered": OrderedDict(a=1), "default": defaultdict(int, a=2), "bytes": b"\xff\x00", "complex": 1j,
        "words": np.array(["a", "bc"]), "fortran": np.asfortranarray(np.eye(3)[:2]),
    }  # fmt: skip
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps(value, protocol=protocol))
    read = read_pickle(path)
    for key, expected in value.items():
        assert np.array_equal(read[key], expected) and type(read[key]) is type(expected), key


@settings(max_examples=10, deadline=None)
@given(st.data())
def test_a_damaged_pickle_is_refused_or_read_but_never_crashes(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    whole = bytearray(pickle.dumps(recording()))
    path = tmp_path_factory.getbasetemp() / "sd_x.pkl"
    for _ in range(data.draw(st.integers(0, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole)))])
    try:
        read_pickle(path)
    except InputError as error:
        assert "sd_x.pkl" in str(error)


RECONSTRUCT = np.zeros(1).__reduce__()[0]


@pytest.mark.parametrize(
    "claim",
    [
        Call(bytearray, 10**11),
        Call(bytes, 10**11),
        Call(np.ndarray, (10**11,), "u1"),
        Call(RECONSTRUCT, np.ndarray, (10**11,), b"b"),
        Call(RECONSTRUCT, np.ndarray, (0,), b"b", state=(1, (3,), np.dtype("O"), False, [])),
    ],
    ids=["bytearray", "bytes", "array", "empty array", "array of objects that are missing"],
)
def test_a_pickle_cannot_claim_memory_that_it_does_not_bring(tmp_path: Path, claim: Call) -> None:
    (tmp_path / "sd_x.pkl").write_bytes(pickle.dumps({"id": claim}))
    with pytest.raises(InputError, match=r"sd_x\.pkl is not a readable pickle"):
        read_pickle(tmp_path / "sd_x.pkl")


@pytest.mark.parametrize(("name", "x", "message"), [("0", 1e9, "the ego moves at"), ("1", 1e300, "cannot be metres")])
def test_positions_that_cannot_be_metres_are_refused(tmp_path: Path, name: str, x: float, message: str) -> None:
    value = recording()
    value["tracks"][name]["state"]["position"][5, 0] = x if name == "1" else 1e7
    with pytest.raises(InputError, match=message):
        read_scenarionet(write(tmp_path, value))


def test_files_are_found_and_folders_without_any_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder"):
        find_scenarionet(tmp_path / "none")
    with pytest.raises(InputError, match="has no ScenarioNet files"):
        find_scenarionet(tmp_path)
    (tmp_path / "deep").mkdir()
    inside = write(tmp_path / "deep", recording(), "sd_a.pkl")
    write(tmp_path, {}, "dataset_summary.pkl")
    assert find_scenarionet(tmp_path) == (inside,) and find_scenarionet(inside) == (inside,)
    with pytest.raises(InputError, match="cannot read"):
        read_scenarionet(tmp_path / "sd_none.pkl")


@needs_shared
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem[-10:])
def test_real_scenes_agree_with_the_golden_protocol_inputs(path: Path) -> None:
    """Poses, futures, commands and boxes of ``golden/protocols``, which come from the same recordings."""
    scene = read_scenarionet(path)
    golden = dict(np.load(SHARED / "golden" / "protocols" / f"{scene.name}.npz"))
    truths = compute_truth(scene, [str(index) for index in range(len(scene.keyframes))])
    assert len(truths) == len(golden["ego_pose"]) and scene.road_map.location in OFFICIAL_LOCATIONS
    assert np.allclose(scene.ego.pose[scene.keyframes], golden["ego_pose"], atol=1e-9)
    assert scene.road_map.is_drivable(scene.ego.position[:, :2]).all()
    assert sum(bool(lane.successors) for lane in scene.road_map.lanes.values()) > 0.8 * len(scene.road_map.lanes)
    for index, truth in enumerate(truths):
        assert np.allclose(truth.lidar_pose[:2], golden["lidar_pose"][index, :2], atol=1e-6)
        assert np.array_equal(truth.ego_future_valid, golden["ego_fut_valid"][index])
        valid = truth.ego_future_valid
        assert np.allclose(truth.ego_future[valid], golden["ego_fut"][index][valid], atol=1e-5)
        assert int(truth.command) == golden["command"][index]
        objects = slice(*golden["obj_offset"][index : index + 2])
        names = [str(golden["instance_names"][number]) for number in golden["obj_instance"][objects]]
        assert set(names) == set(truth.instances)
        rows = [truth.instances.index(name) for name in names]
        annotated = golden["obj_annotated"][objects]
        assert np.array_equal(truth.annotated[rows], annotated)
        assert [truth.categories[row] for row in rows] == golden["class_names"][golden["obj_class"][objects]].tolist()
        difference = truth.boxes[rows][..., [0, 1, 4]] - golden["obj_box"][objects]
        difference[..., 2] = np.sin(difference[..., 2] / 2)
        assert np.abs(difference[annotated]).max(initial=0.0) < 1e-4
        sizes = np.broadcast_to(golden["obj_size"][objects][:, None], (*annotated.shape, 2))
        assert np.allclose(truth.boxes[rows][..., 2:4][annotated], sizes[annotated], atol=1e-5)


@needs_shared
def test_real_boxes_are_centres_on_the_global_ground() -> None:
    scene = read_scenarionet(FILES[0])
    cars = [index for index, name in enumerate(scene.agents.categories) if name == "vehicle.car"]
    bottoms = scene.agents.position[cars, :, 2] - scene.agents.size[cars, 2][:, None] / 2
    assert np.abs(np.median(bottoms)) < 0.6
    truth = compute_truth(scene, [str(index) for index in range(len(scene.keyframes))])[0]
    right, forward = truth.boxes[0, 0, :2]
    row = scene.agents.ids.index(truth.instances[0])
    assert np.allclose(to_global(np.array([forward, -right]), truth.lidar_pose), scene.annotations.position[row, 0, :2])
