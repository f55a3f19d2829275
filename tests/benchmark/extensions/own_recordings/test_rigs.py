"""Which camera is which view: by name, by direction; what is no rig is refused in one sentence."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.constants import CAMERA_NAMES
from benchmark.errors import InputError
from benchmark.extensions.own_recordings.rig_notes import list_caveats
from benchmark.extensions.own_recordings.rigs import (
    READY,
    choose_views,
    find_angles,
    name_missing_views,
    parse_rig,
    read_rig,
)
from benchmark.records.run_schema import PlannerFacts
from benchmark.scene import Camera

GOLDEN = Path(__file__).resolve().parents[4].parent / "shared" / "golden" / "123d" / "av2" / "expected.json"
Angles = tuple[float, float, float]
"""Heading, pitch and horizontal field of view, degrees."""


def rotation(yaw_deg: float, pitch_deg: float = 0.0) -> list[float]:
    """Quaternion w, x, y, z of a camera (x right, y down, z ahead) that looks along a heading and up by a pitch."""
    optical = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    x, y, z, w = (Rotation.from_euler("ZY", [yaw_deg, -pitch_deg], degrees=True) * optical).as_quat().tolist()
    return [w, x, y, z]


def tables(cameras: Mapping[str, Angles], lidars: Mapping[str, float] | None = None) -> dict[str, list[dict[str, Any]]]:
    """The two tables of sensors; lidars by the heading of their x axis."""
    sensors = [{"token": name, "channel": name, "modality": "camera"} for name in cameras]
    sensors += [{"token": name, "channel": name, "modality": "lidar"} for name in lidars or ()]
    mounts: list[dict[str, Any]] = [
        {
            "sensor_token": name,
            "rotation": rotation(yaw, pitch),
            "camera_intrinsic": [[800 / np.tan(np.radians(fov / 2)), 0, 800], [0, 1000, 450], [0, 0, 1]],
        }
        for name, (yaw, pitch, fov) in cameras.items()
    ]
    turned = {name: np.radians(yaw) / 2 for name, yaw in (lidars or {}).items()}
    mounts += [
        {"sensor_token": name, "rotation": [np.cos(half), 0.0, 0.0, np.sin(half)], "camera_intrinsic": []}
        for name, half in turned.items()
    ]
    return {"sensor": sensors, "calibrated_sensor": mounts}


def named(*names: str) -> dict[str, list[dict[str, Any]]]:
    return tables(dict.fromkeys(names, (0.0, 0.0, 65.0)))


NUPLAN = [f"CAM_{place}" for place in ("F0", "L0", "R0", "L1", "R1", "L2", "R2", "B0")]
RING = [
    f"ring_{place}"
    for place in ("front_center", "front_left", "front_right", "side_left", "side_right", "rear_left", "rear_right")
]


@pytest.mark.parametrize(
    ("rig", "cameras", "missing"),
    [
        ("nuscenes", CAMERA_NAMES, ()),
        ("nuplan", NUPLAN, ()),
        ("argoverse2", RING, ()),
        ("waymo", ["FRONT", "FRONT_LEFT", "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT"], ("CAM_BACK",)),
        # As 123D calls them.
        ("waymo", ["front", "front_left", "front_right", "left", "right"], ("CAM_BACK",)),
        ("front", ["dashcam"], CAMERA_NAMES[1:]),
    ],
)
def test_ready_rigs_name_the_views_of_their_data_sets(rig: str, cameras: Sequence[str], missing: Sequence[str]) -> None:
    chosen = choose_views(read_rig(rig), named(*cameras))
    assert set(chosen.values()) == set(CAMERA_NAMES) - set(missing)
    assert len(set(chosen.values())) == len(chosen) and set(chosen) <= set(cameras)
    left = [name for name in cameras if "left" in name.casefold() or name.startswith("CAM_L")]
    assert {chosen[name] for name in left if name in chosen and chosen[name] != "CAM_BACK"} <= {
        "CAM_FRONT_LEFT",
        "CAM_BACK_LEFT",
    }
    said = name_missing_views(tuple((f"sensor:{name}", view) for name, view in chosen.items()))
    assert [all(view in text for view in missing) for text in said] == [True] * bool(missing)


def test_directions_are_given_one_to_one_with_the_least_squares() -> None:
    seen = {"a": 4.0, "b": 61.0, "c": -49.0, "d": 171.0, "e": 104.0, "f": -118.0, "up": 20.0}
    chosen = choose_views(read_rig("directions"), tables({name: (yaw, 0.0, 70.0) for name, yaw in seen.items()}))
    views = dict(zip("abcdef", ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "BACK", "BACK_LEFT", "BACK_RIGHT"), strict=True))
    assert chosen == {name: f"CAM_{view}" for name, view in views.items()}
    # 153 degrees are nearer to 180 than to 110, but somebody has to be the left one: 27² + 11² < 43² + 81².
    both = choose_views(read_rig("directions"), tables({"side": (99.0, 0.0, 65.0), "rear": (153.0, 0.0, 65.0)}))
    assert both == {"side": "CAM_BACK_LEFT", "rear": "CAM_BACK"}


def test_of_two_cameras_with_one_direction_the_field_of_view_decides() -> None:
    cameras = {"tele": (0.0, 0.0, 30.0), "wide": (1.0, 0.0, 120.0), "usual": (2.0, 0.0, 62.0)}
    assert choose_views(read_rig("front"), tables(cameras)) == {"usual": "CAM_FRONT"}
    asked = parse_rig({"CAM_FRONT": {"yaw_deg": 0, "fov_deg": 118}}, "mine.json")
    assert choose_views(asked, tables(cameras)) == {"wide": "CAM_FRONT"}
    nearest = parse_rig({"CAM_FRONT": {"yaw_deg": 0}}, "mine.json")
    assert choose_views(nearest, tables(cameras)) == {"tele": "CAM_FRONT"}


def test_names_and_directions_together_and_a_lidar_that_looks_ahead() -> None:
    found = tables({"one": (180.0, 0.0, 90.0), "two": (178.0, 0.0, 90.0)}, {"OS1": -90.0})
    rig = parse_rig({"one": "CAM_FRONT", "OS1": "LIDAR_TOP", "CAM_BACK": {"yaw_deg": -180}}, "mine.json")
    assert choose_views(rig, found) == {"one": "CAM_FRONT", "two": "CAM_BACK", "OS1": "LIDAR_TOP"}


@pytest.mark.parametrize(
    ("read", "found", "said"),
    [
        ({"left": "CAM_FRONT"}, named("right"), "names left, which is no sensor here: the data set has right"),
        ({"a": "CAM_FRONT"}, named("a", "CAM_FRONT"), "two sensors would be CAM_FRONT, CAM_FRONT and a"),
        ({"a": "CAM_FRONT", "A": "CAM_BACK"}, {"sensor": [], "calibrated_sensor": []}, "has no camera"),
        ({"CAM_BACK": {"yaw_deg": 180}}, named("a"), "fits no camera: the data set has a"),
        ("nuplan", named("front"), "the rig nuplan fits no camera: the data set has front"),
        ("nuscenes", tables({}, {"top": -90.0}), "the data set has no camera"),
        ({"OS1": "LIDAR_TOP"}, tables({}, {"OS1": 0.0}), "OS1 cannot be LIDAR_TOP, whose y axis points ahead"),
        ({"OS1": "CAM_BACK"}, tables({}, {"OS1": 0.0}), "makes OS1 CAM_BACK, but it is a lidar"),
        (
            {"CAM_FRONT": {"yaw_deg": 0}},
            {
                "sensor": named("a")["sensor"],
                "calibrated_sensor": [
                    *named("a")["calibrated_sensor"],
                    *tables({"a": (90.0, 0.0, 65.0)})["calibrated_sensor"],
                ],
            },
            "a looks in different directions in different logs",
        ),
        (
            {"CAM_FRONT": {"yaw_deg": 0}},
            {"sensor": named("a")["sensor"], "calibrated_sensor": []},
            "the data set has no camera",
        ),
    ],
)
def test_a_rig_that_does_not_fit_is_refused(read: Any, found: Any, said: str) -> None:
    rig = read_rig(read) if isinstance(read, str) else parse_rig(read, "mine.json")
    with pytest.raises(InputError, match=said) as refused:
        choose_views(rig, found)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("read", "said"),
    [
        ([], "is not a JSON object of cameras"),
        ({}, "is not a JSON object of cameras"),
        ({"cameras": 3}, "is not a JSON object of cameras"),
        ({"cameras": "nuplam"}, "names the rig 'nuplam'; built in are nuscenes"),
        ({"a": "CAM_FRUNT"}, "maps 'a' to 'CAM_FRUNT'; views are CAM_FRONT"),
        ({"a": "CAM_FRONT", "b": "CAM_FRONT"}, "has two cameras for CAM_FRONT: a and b"),
        ({"a": "CAM_BACK", "CAM_BACK": {"yaw_deg": 0}}, "has two cameras for CAM_BACK: a and a direction"),
        ({"front": {"yaw_deg": 0}}, "gives a direction for 'front'"),
        ({"CAM_FRONT": {}}, "CAM_FRONT must be"),
        ({"CAM_FRONT": {"yaw_deg": float("nan")}}, "CAM_FRONT must be"),
        ({"CAM_FRONT": {"yaw_deg": 0, "fov_deg": -1}}, "CAM_FRONT must be"),
        ({"CAM_FRONT": {"yaw_deg": 0, "fow_deg": 65}}, "CAM_FRONT must be"),
        ({"lidar": [1, 2]}, '"lidar" must be'),
        ({"lidar": [1, 2, float("inf")]}, '"lidar" must be'),
        ({"lidar": [1, 2, True]}, '"lidar" must be'),
    ],
)
def test_a_file_that_is_no_rig_is_refused(tmp_path: Path, read: Any, said: str) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(read))
    with pytest.raises(InputError, match=said) as refused:
        read_rig(str(path))
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)


def test_names_of_rigs_that_there_are_not() -> None:
    with pytest.raises(InputError, match="did you mean waymo"):
        read_rig("waimo")
    assert set(READY) == {"nuscenes", "nuplan", "argoverse2", "waymo", "front", "directions"}


def camera(view: str, yaw: float, *, focal: float, high: float, pitch: float = 0.0, size: Any = (1600, 900)) -> Camera:
    matrix = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1.0]])
    return Camera(view, np.array([1.0, 0.0, high]), np.array(rotation(yaw, pitch)), matrix, *size)


def test_notes_say_how_far_a_rig_is_from_nuscenes() -> None:
    network = PlannerFacts(name="uniad", privileged=False, wants=["images", "motion"])
    alike = [camera("CAM_FRONT", 0.5, focal=1270.0, high=1.5, pitch=0.5)]
    (absent,) = list_caveats(network, (), alike)
    assert absent.startswith("the rig has no camera for CAM_FRONT_RIGHT, CAM_FRONT_LEFT, CAM_BACK,")
    # A portrait picture is squeezed into 16:9: its focal lengths part.
    other = [
        camera("CAM_FRONT", 0.0, focal=1686.0, high=1.38, size=(1550, 2048)),
        camera("CAM_BACK", 153.0, focal=809.0, high=1.57, pitch=-1.8),
    ]
    said = list(list_caveats(network, (("lidar:", "1.0 0.0 1.7"),), other))
    assert said[1] == "plans are given from a stated place of the lidar, 1.0, 0.0, 1.7 m in the ego frame"
    assert "CAM_FRONT focal length 1740 x 741 px, not 1266, 1.38 m high, not 1.51" in said[2]
    assert "CAM_BACK pitch -1.8 degrees, turned by -27 degrees" in said[2]
    blind = PlannerFacts(name="constant-velocity", privileged=False, wants=["motion"])
    assert list(list_caveats(blind, (), other)) == []
    stranger = PlannerFacts(name="mine", privileged=False)
    assert [text.startswith("the rig has no camera") for text in list_caveats(stranger, (), other)] == [True]


@pytest.mark.skipif(not GOLDEN.is_file(), reason="needs the golden logs of 123D")
def test_an_argoverse_2_log_of_123d() -> None:
    (log,) = json.loads(GOLDEN.read_text())["logs"].values()
    cameras = {}
    for of in log["cameras"].values():
        fov = 2 * np.degrees(np.arctan2(of["matrix"][0][2], of["matrix"][0][0]))
        cameras[of["name"]] = (of["view_yaw_deg"], of["view_pitch_deg"], float(fov))
    found = tables(cameras)
    for name, (yaw, pitch, _) in cameras.items():
        (mount,) = (row for row in found["calibrated_sensor"] if row["sensor_token"] == name)
        assert np.allclose(find_angles(mount["rotation"]), (yaw, pitch), atol=1e-6)
    chosen = choose_views(read_rig("argoverse2"), found)
    assert set(chosen.values()) == set(CAMERA_NAMES) and chosen["ring_rear_left"] == "CAM_BACK"
    looked = choose_views(read_rig("directions"), found)
    sides = {name: view for name, view in chosen.items() if "front_center" not in name and "rear" not in name}
    assert sides.items() <= looked.items() and set(looked.values()) == set(CAMERA_NAMES)
