import json
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.roots import open_data
from benchmark.datasets.split_names import scenes_of_split
from benchmark.errors import InputError
from tests.benchmark.datasets.nuscenes_tables import VERSION, TinyRoot
from tests.hand_made import scene_on_straight_road

SHARED = Path(__file__).resolve().parents[4] / "shared"


def tiny(root: Path) -> TinyRoot:
    return TinyRoot.of(root, [scene_on_straight_road(seconds=2.0)])


def unlink(table: str) -> Callable[[Path], None]:
    return lambda root: (root / VERSION / f"{table}.json").unlink()


def truncate(table: str) -> Callable[[Path], None]:
    def act(root: Path) -> None:
        path = root / VERSION / f"{table}.json"
        path.write_text(path.read_text()[:-20])

    return act


def edit(table: str, field: str, value: object, *, row: int = 0) -> Callable[[Path], None]:
    def act(root: Path) -> None:
        path = root / VERSION / f"{table}.json"
        rows = json.loads(path.read_text())
        if value is None:
            del rows[row][field]
        else:
            rows[row][field] = value
        path.write_text(json.dumps(rows))

    return act


def replace_table(table: str, value: object) -> Callable[[Path], None]:
    def act(root: Path) -> None:
        (root / VERSION / f"{table}.json").write_text(json.dumps(value))

    return act


FAULTS: dict[str, tuple[Callable[[Path], None], str]] = {
    "a table missing": (unlink("visibility"), r"lacks visibility\.json"),
    "truncated JSON": (truncate("sample_data"), r"sample_data\.json is not valid JSON"),
    "a table that is an object": (replace_table("sample", {"a": 1}), r"sample\.json must hold a JSON list"),
    "a row that is not an object": (replace_table("sample_annotation", [3]), "row 0 is not an object with a token"),
    "a field missing": (edit("sample_data", "ego_pose_token", None), "has no field 'ego_pose_token'"),
    "dangling instance": (
        edit("sample_annotation", "instance_token", "gone"),
        r"instance_token gone is not in instance",
    ),
    "dangling ego pose": (edit("sample_data", "ego_pose_token", "gone"), r"ego_pose_token gone is not in ego_pose"),
    "dangling calibration": (edit("sample_data", "calibrated_sensor_token", "gone"), "calibrated_sensor_token gone"),
    "dangling sample": (edit("sample", "next", "gone"), "next gone is not in sample"),
    "dangling attribute": (edit("sample_annotation", "attribute_tokens", ["gone"]), "attribute_tokens gone"),
    "dangling log": (edit("scene", "log_token", "gone"), "log_token gone"),
    "an unhashable token": (edit("sample_annotation", "instance_token", ["a"]), "is not in instance"),
    "no map for the log": (edit("map", "log_tokens", []), "no map lists log"),
    "no map at all": (replace_table("map", []), "no map lists log"),
    "mask missing": (edit("map", "filename", "maps/none.png"), r"map mask .*none\.png"),
    "NaN in an ego pose": (
        edit("ego_pose", "translation", [1.0, float("nan"), 0.0]),
        r"ego_pose\.json row .*translation is \[1\.0, nan",
    ),
    "NaN in an annotation": (
        edit("sample_annotation", "translation", [float("nan")] * 3),
        r"sample_annotation\.json row .*translation",
    ),
    "infinite rotation": (edit("ego_pose", "rotation", [float("inf"), 0, 0, 0]), "rotation"),
    "zero rotation": (edit("ego_pose", "rotation", [0, 0, 0, 0]), "non-zero quaternion"),
    "two numbers as a position": (edit("ego_pose", "translation", [1.0, 2.0]), "must be 3 numbers"),
    "words as a size": (edit("sample_annotation", "size", ["a", "b", "c"]), "must be 3 numbers"),
    "negative size": (edit("sample_annotation", "size", [-1.0, 4.0, 2.0]), "positive"),
    "a token twice": (edit("ego_pose", "token", "scene-9901-LIDAR_TOP-1"), "two rows with token"),
    "a scene name twice": (edit("scene", "name", 7), "used twice"),
    "no scenes": (replace_table("scene", []), r"scene\.json is empty"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_broken_root_is_refused_in_one_sentence(tmp_path: Path, fault: str) -> None:
    damage, message = FAULTS[fault]
    root = tiny(tmp_path).write()
    damage(root)
    with pytest.raises(InputError, match=message) as caught:
        NuScenesData.open(root)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [("scene_token", "scene-9902-token", "belongs to another scene"), ("timestamp", 5, "not later than")],
)
def test_a_broken_chain_of_samples_is_refused(tmp_path: Path, field: str, value: object, message: str) -> None:
    made = TinyRoot.of(tmp_path, [scene_on_straight_road(seconds=2.0, name=f"scene-990{n}") for n in (1, 2)])
    made.row("sample", "scene-9901-sample-2")[field] = value
    data = NuScenesData.open(made.write())
    with pytest.raises(InputError, match=message):
        data.scene("scene-9901")
    assert len(data.truth("scene-9902")) == 4


def test_a_circle_of_samples_is_refused(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    made.tables["sample"][-1]["next"] = made.tables["sample"][0]["token"]
    with pytest.raises(InputError, match="not later than"):
        NuScenesData.open(made.write()).scene("scene-9901")


def test_a_sample_without_sensors_is_refused(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    for row in made.tables["sample_data"]:
        row["is_key_frame"] = row["is_key_frame"] and row["sample_token"] != "scene-9901-sample-1"
    with pytest.raises(InputError, match="ego pose is unknown"):
        NuScenesData.open(made.write()).scene("scene-9901")


def test_a_camera_without_intrinsics_is_refused(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    made.row("calibrated_sensor", "scene-9901-CAM_FRONT")["camera_intrinsic"] = []
    with pytest.raises(InputError, match="camera_intrinsic"):
        NuScenesData.open(made.write()).scene("scene-9901")


def test_roots_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder"):
        open_data(tmp_path / "nowhere")
    with pytest.raises(InputError, match="no version folder"):
        open_data(tmp_path)
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(InputError, match="is not a folder"):
        open_data(file)


def test_one_version_is_found_and_several_are_asked_for(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    made.write()
    assert NuScenesData.open(tmp_path).version == VERSION
    made.version = "nightly"
    made.write()
    with pytest.raises(InputError, match=f"several versions \\(nightly, {VERSION}\\)"):
        NuScenesData.open(tmp_path)
    assert NuScenesData.open(tmp_path, version="nightly").scene_names() == ("scene-9901",)
    with pytest.raises(InputError, match="no version folder 'v2'"):
        NuScenesData.open(tmp_path, version="v2")


def test_empty_label_tables_are_fine(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    made.tables["attribute"], made.tables["visibility"] = [], []
    for row in made.tables["sample_annotation"]:
        row["attribute_tokens"] = []
        row["visibility_token"] = ""
    known = NuScenesData.open(made.write()).scene("scene-9901").annotations
    assert (known.visibility == 0).all() and (known.attribute == "").all()


def test_a_scene_without_objects_is_fine(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    made.tables["sample_annotation"], made.tables["instance"] = [], []
    data = NuScenesData.open(made.write())
    assert len(data.scene("scene-9901").agents) == 0
    assert data.truth("scene-9901")[0].boxes.shape == (0, 7, 5)


def splits(
    split: str, present: list[str], custom: dict[str, list[str]] | None = None, built_as: str | None = None
) -> tuple[str, ...]:
    return scenes_of_split(split, present, custom or {}, where="here", built_as=built_as)


def test_split_rules() -> None:
    mini = ["scene-0061", "scene-0103", "scene-0553", "scene-0916"]
    assert splits("val", ["b", "a"], {"val": ["b"]}) == ("b",)
    assert splits("val", ["b", "a"]) == ("a", "b")
    assert splits("val", mini) == ("scene-0103", "scene-0553", "scene-0916")
    assert splits("mini_val", mini) == ("scene-0103", "scene-0916")
    assert splits("train", mini) == ("scene-0061",)
    published = ["scene-0003-b", "scene-0003-a"]
    assert splits("adv", published) == ("scene-0003-a", "scene-0003-b")
    with pytest.raises(InputError, match="it has mini_train, mini_val, train, train_detect, val"):
        splits("adv", mini)
    with pytest.raises(InputError, match="x into 'val'"):
        splits("val", ["a"], {"val": ["x"]})


@pytest.mark.parametrize(
    ("present", "custom", "built_as", "says"),
    [
        (["a", "b"], {"adv": ["a"]}, None, "the only one is adv"),
        (["a", "b"], {"adv": ["a"], "own": ["b"]}, None, "it has adv, own"),
        (["a", "b"], {}, "adv", "the only one is adv"),
        (["scene-0103"], {"adv": ["scene-0103"]}, "adv", "the only one is adv"),
        (["scene-0003-a"], {}, None, "the only one is adv"),
        (["scene-0061"], {}, None, "it has mini_train, train, train_detect"),
    ],
)
def test_only_recorded_validation_scenes_are_val(
    present: list[str], custom: dict[str, list[str]], built_as: str | None, says: str
) -> None:
    """`val` is the default: of adversarial scenes it would give the rate of adv under the name of val."""
    with pytest.raises(InputError, match=f"here has no split 'val'; {says}"):
        splits("val", present, custom, built_as)


@pytest.mark.parametrize("content", ["[]", '{"val": "scene-1"}', '{"val": ["a", "a"]}', "{"])
def test_a_broken_splits_file_is_refused(tmp_path: Path, content: str) -> None:
    root = tiny(tmp_path).write()
    (root / VERSION / "splits.json").write_text(content)
    with pytest.raises(InputError, match=r"splits\.json"):
        NuScenesData.open(root)


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared material beside the repository")
@pytest.mark.parametrize(
    ("root", "message"),
    [
        ("thirdparty_nuscenes_format_hudang", r"v1\.0-mini lacks attribute\.json, category\.json"),
        ("lyft_v1.01_tables_mmdet3d_tests", "no version folder"),
        ("scene0061_tables_v1.0-test", "no version folder"),
    ],
)
def test_real_malformed_roots_are_refused(root: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        NuScenesData.open(SHARED / "data" / "nuscenes" / root)


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared material beside the repository")
def test_real_tables_with_dangling_tokens_are_refused(tmp_path: Path) -> None:
    """Thirteen real but cut-down tables of another data set in this format."""
    source = SHARED / "data" / "nuscenes" / "lyft_v1.01_tables_mmdet3d_tests"
    (tmp_path / "v1.01").mkdir()
    for table in NUSCENES_TABLES:
        (tmp_path / "v1.01" / f"{table}.json").write_bytes((source / f"{table}.json").read_bytes())
    with pytest.raises(InputError, match=r"is not in \w+\.json"):
        NuScenesData.open(tmp_path)
