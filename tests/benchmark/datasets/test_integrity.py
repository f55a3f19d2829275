"""The table checker: silent on what the writer writes, and it finds every planted fault."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.schema import Fault
from benchmark.datasets.schema.check import check_tables
from benchmark.errors import InputError
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from tests.generation.nuscenes_writer.written_roots import SolidRenderer, short_scene, with_adversary, write_root

VERSION = "v1.0-trainval"
SHARED = Path(__file__).resolve().parents[4] / "shared"
Rows = list[dict[str, Any]]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("sound")
    scenes = [with_adversary(short_scene("scene-9901", seconds=1.5)), short_scene("scene-9902", seconds=1.5)]
    plan = DataSetPlan(root=root, split="adv", renderer=SolidRenderer(), frames="keyframes")
    keys = [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={}) for scene in scenes]
    finish_data_set(plan, keys)
    shutil.rmtree(root / ".challenger")
    return root


@pytest.fixture
def root(sound: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sound, tmp_path / "data"))


def edit(root: Path, table: str, change: Callable[[Any], Any]) -> None:
    """Change a table in place; ``change`` may return a new value."""
    path = root / VERSION / f"{table}.json"
    rows = json.loads(path.read_text())
    result = change(rows)
    path.write_text(json.dumps(rows if result is None else result))


def field(table: str, name: str, value: Any, row: int = 1) -> Callable[[Path], None]:
    """A fault: one field of one row gets another value."""
    return lambda root: edit(root, table, lambda rows: rows[row].update({name: value}))


def image(root: Path, camera: str = "CAM_FRONT") -> Path:
    return sorted(root.glob(f"samples/{camera}/*.jpg"))[0]


def drop_field(root: Path) -> None:
    edit(root, "sample_annotation", lambda rows: rows[3].pop("size") and None)


def duplicate_token(root: Path) -> None:
    edit(root, "ego_pose", lambda rows: rows[1].update(token=rows[0]["token"]))


def one_way_link(root: Path) -> None:
    edit(root, "sample", lambda rows: rows[1].update(prev=rows[2]["token"]))


def circle(root: Path) -> None:
    def change(rows: Rows) -> None:
        rows[0]["prev"], rows[2]["next"] = rows[2]["token"], rows[0]["token"]

    edit(root, "sample", change)


def two_chains(root: Path) -> None:
    def change(rows: Rows) -> None:
        rows[1]["next"], rows[2]["prev"] = "", ""

    edit(root, "sample_data", change)


def other_scenes_sample(root: Path) -> None:
    edit(root, "sample", lambda rows: rows[2].update(next=rows[3]["token"]))


def back_in_time(root: Path) -> None:
    edit(root, "sample", lambda rows: rows[1].update(timestamp=rows[0]["timestamp"]))


def wrong_first_sample(root: Path) -> None:
    edit(root, "scene", lambda rows: rows[0].update(first_sample_token=rows[0]["last_sample_token"]))


def wrong_last_annotation(root: Path) -> None:
    edit(root, "instance", lambda rows: rows[0].update(last_annotation_token=rows[0]["first_annotation_token"]))


def annotated_twice(root: Path) -> None:
    edit(root, "sample_annotation", lambda rows: rows[1].update(sample_token=rows[0]["sample_token"]))


def no_keyframe_row(root: Path) -> None:
    edit(root, "sample_data", lambda rows: rows[4].update(is_key_frame=False))


def sensor_twice(root: Path) -> None:
    edit(root, "sample_data", lambda rows: rows[1].update(sample_token=rows[0]["sample_token"]))


def late_keyframe(root: Path) -> None:
    edit(root, "sample_data", lambda rows: rows[2].update(timestamp=rows[2]["timestamp"] + 150_000))


def late_pose(root: Path) -> None:
    edit(root, "ego_pose", lambda rows: rows[2].update(timestamp=rows[2]["timestamp"] - 150_000))


def nanoseconds(root: Path) -> None:
    edit(root, "sample", lambda rows: rows[0].update(timestamp=rows[0]["timestamp"] * 1000))


def copied_intrinsic(root: Path) -> None:
    sensors = {row["token"]: row["channel"] for row in json.loads((root / VERSION / "sensor.json").read_text())}

    def change(rows: Rows) -> None:
        front = next(row for row in rows if sensors[row["sensor_token"]] == "CAM_FRONT")
        for row in rows:
            if row["camera_intrinsic"]:
                row["camera_intrinsic"] = front["camera_intrinsic"]

    edit(root, "calibrated_sensor", change)


def same_name(root: Path) -> None:
    edit(root, "scene", lambda rows: rows[1].update(name=rows[0]["name"]))


def same_file(root: Path) -> None:
    edit(root, "sample_data", lambda rows: rows[1].update(filename=rows[0]["filename"]))


def unmapped_log(root: Path) -> None:
    edit(root, "map", lambda rows: rows[0].update(log_tokens=rows[0]["log_tokens"][1:]))


def weak_adversary(root: Path) -> None:
    edit(root, "sample_annotation", lambda rows: rows[1].update(num_lidar_pts=0, num_radar_pts=9))


def walking_adversary(root: Path) -> None:
    categories = json.loads((root / VERSION / "category.json").read_text())
    walker = next(row["token"] for row in categories if row["name"] == "human.pedestrian.adult")
    edit(root, "instance", lambda rows: rows[0].update(category_token=walker))


def adversaries(*tokens: str) -> Callable[[Path], None]:
    def change(content: Any) -> None:
        content["scenes"]["scene-9901"]["adversaries"] = list(tokens)

    return lambda root: edit(root, "challenger", change)


def foreign_adversary(root: Path) -> None:
    instances = json.loads((root / VERSION / "instance.json").read_text())
    adversaries(instances[-1]["token"])(root)


def forgotten_scene(root: Path) -> None:
    edit(root, "challenger", lambda content: content["scenes"].pop("scene-9902") and None)


def replace_file(name: str, content: bytes | None) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        path = next(iter(sorted(root.glob(name))))
        if content is None:
            path.unlink()
        else:
            path.write_bytes(content)

    return change


def image_with(content: bytes) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        image(root).write_bytes(content)

    return change


def truncated_image(root: Path) -> None:
    image(root).write_bytes(image(root).read_bytes()[:-30])


def half_a_mask(root: Path) -> None:
    mask = next(root.glob("maps/*.png"))
    mask.write_bytes(mask.read_bytes()[:500])


def mapless_layers(root: Path) -> None:
    path = root / "maps/expansion/boston-seaport.json"
    path.write_text(json.dumps({"version": "1.3", "lane": []}))


PLANTED: list[tuple[str, Callable[[Path], None], str, str]] = [
    ("no table", replace_file(f"{VERSION}/instance.json", None), "instance", "instance.json is missing"),
    (
        "half a table",
        replace_file(f"{VERSION}/sample.json", b'[{"token": "a", "ti'),
        "sample",
        "is not a JSON list of rows",
    ),
    ("an object", replace_file(f"{VERSION}/log.json", b"{}"), "log", "does not begin with ["),
    (
        "a number as row",
        lambda root: edit(root, "log", lambda rows: [*rows, 3]),
        "log",
        "a row is no object",
    ),
    ("no field", drop_field, "sample_annotation", "size is missing"),
    ("text for number", field("ego_pose", "translation", ["1", 2, 3]), "ego_pose", "must be three finite numbers"),
    ("number for flag", field("sample_data", "is_key_frame", 1), "sample_data", "must be true or false"),
    ("token twice", duplicate_token, "ego_pose", "two rows have this token"),
    ("no such sample", field("sample_annotation", "sample_token", "gone"), "sample_annotation", "not in sample.json"),
    ("no such category", field("instance", "category_token", "gone"), "instance", "not in category.json"),
    ("no such attribute", field("sample_annotation", "attribute_tokens", ["x"]), "sample_annotation", "attribute.json"),
    ("no such log", field("scene", "log_token", "gone"), "scene", "not in log.json"),
    ("no such pose", field("sample_data", "ego_pose_token", "gone"), "sample_data", "not in ego_pose.json"),
    ("no such visibility", field("sample_annotation", "visibility_token", "9"), "sample_annotation", "visibility.json"),
    ("one-way link", one_way_link, "sample", "but prev of that row"),
    ("circle", circle, "sample", "form a cycle"),
    ("two chains", two_chains, "sample_data", "are reached from its first one"),
    ("into another scene", other_scenes_sample, "sample", "is not a row of scene"),
    ("back in time", back_in_time, "sample", "is not later"),
    ("sample count", field("scene", "nbr_samples", 7), "scene", "nbr_samples is 7, but the scene has 3 samples"),
    ("annotation count", field("instance", "nbr_annotations", 2), "instance", "nbr_annotations is 2"),
    ("first sample", wrong_first_sample, "scene", "the first is"),
    ("last annotation", wrong_last_annotation, "instance", "the last is"),
    ("annotated twice", annotated_twice, "sample_annotation", "another annotation at sample"),
    ("no keyframe row", no_keyframe_row, "sample", "no keyframe row of"),
    ("sensor twice", sensor_twice, "sample", "2 keyframe rows of LIDAR_TOP"),
    ("late keyframe", late_keyframe, "sample_data", "0.15 s away from its sample"),
    ("late pose", late_pose, "sample_data", "ego pose is from 0.15 s away"),
    ("nanoseconds", nanoseconds, "sample", "must be a whole number of microseconds"),
    ("long quaternion", field("ego_pose", "rotation", [1, 1, 0, 0]), "ego_pose", "of norm one"),
    ("copied intrinsic", copied_intrinsic, "calibrated_sensor", "as if it were copied"),
    ("same scene name", same_name, "scene", "2 rows have the name"),
    ("same file", same_file, "sample_data", "also belongs to"),
    ("no image", lambda root: image(root).unlink(), "sample_data", "is missing"),
    ("empty image", image_with(b""), "sample_data", "is empty"),
    ("truncated image", truncated_image, "sample_data", "not a complete JPEG"),
    ("no image at all", image_with(b"<html></html>"), "sample_data", "not a complete JPEG"),
    ("image size", field("sample_data", "width", 33, row=5), "sample_data", "32 x 18 pixels, the row says 33 x 18"),
    ("half a point", replace_file("samples/LIDAR_TOP/*", b"1234567"), "sample_data", "a whole number of points"),
    ("leaves the root", field("sample_data", "filename", "../../etc/passwd"), "sample_data", "inside it"),
    ("absolute path", field("map", "filename", "/etc/passwd", row=0), "map", "inside it"),
    ("no mask", replace_file("maps/*.png", None), "map", "is missing"),
    ("half a mask", half_a_mask, "map", "not a complete PNG"),
    ("log without map", unmapped_log, "log", "no map has this log"),
    ("no expansion", replace_file("maps/expansion/*", None), "maps/expansion/boston-seaport.json", "is missing"),
    ("poor expansion", mapless_layers, "maps/expansion/boston-seaport.json", "'node' is missing"),
    ("unknown split scene", replace_file(f"{VERSION}/splits.json", b'{"adv": ["scene-1"]}'), "splits.json", "scene-1"),
    (
        "split no list",
        replace_file(f"{VERSION}/splits.json", b'{"adv": "scene-9901"}'),
        "splits.json",
        "must be a list",
    ),
    ("weak adversary", weak_adversary, "sample_annotation", "claims no lidar point"),
    ("walking adversary", walking_adversary, "challenger.json", "human.pedestrian.adult, not a vehicle"),
    ("unknown adversary", adversaries("gone"), "challenger.json", "not in instance.json"),
    ("foreign adversary", foreign_adversary, "challenger.json", "annotated in another scene"),
    ("forgotten scene", forgotten_scene, "challenger.json", "is in scene.json but not in"),
    ("broken provenance", replace_file(f"{VERSION}/challenger.json", b"[1,"), "challenger.json", "cannot be read"),
]
WARNINGS = {"copied intrinsic", "no expansion", "same file"}


def test_nothing_wrong_with_what_the_writer_writes(sound: Path) -> None:
    assert check_tables(sound) == []
    assert check_tables(sound, version=VERSION) == []
    assert check_tables(sound / VERSION) == check_tables(sound / VERSION, version=None)


@pytest.mark.parametrize(("name", "plant", "table", "words"), PLANTED, ids=[planted[0] for planted in PLANTED])
def test_planted_fault(root: Path, name: str, plant: Callable[[Path], None], table: str, words: str) -> None:
    plant(root)
    faults = check_tables(root)
    found = [fault for fault in faults if fault.table == table and words in fault.sentence]
    assert found, faults
    assert {fault.severity for fault in found} == {"warning" if name in WARNINGS else "error"}


def test_every_table_may_be_missing_or_garbage(root: Path) -> None:
    for table in NUSCENES_TABLES:
        path = root / VERSION / f"{table}.json"
        whole = path.read_bytes()
        for content in (None, b"", b"null", b"[[]]", b'[{"token": "a"}]', b"\xff\xfe", whole[: len(whole) // 2]):
            path.unlink(missing_ok=True)
            if content is not None:
                path.write_bytes(content)
            assert any(fault.table == table for fault in check_tables(root)), (table, content)
        path.write_bytes(whole)
    assert check_tables(root) == []


VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-5, 5),
    st.floats(),
    st.text(max_size=3),
    st.lists(st.floats() | st.text(max_size=2), max_size=4),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
)


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_no_value_anywhere_makes_it_crash(small: Path, data: st.DataObject) -> None:
    table = data.draw(st.sampled_from(NUSCENES_TABLES))
    path = small / VERSION / f"{table}.json"
    whole = path.read_bytes()
    rows = json.loads(whole)
    row = data.draw(st.sampled_from(rows))
    row[data.draw(st.sampled_from(sorted(row)))] = data.draw(VALUES)
    try:
        path.write_text(json.dumps(rows))
        assert all(isinstance(fault, Fault) for fault in check_tables(small))
    finally:
        path.write_bytes(whole)


@pytest.fixture(scope="module")
def small(sound: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(sound, tmp_path_factory.mktemp("small") / "data"))


def test_many_faults_of_a_kind_are_counted(root: Path) -> None:
    shutil.rmtree(root / "samples")
    faults = check_tables(root)
    assert len(faults) == 6
    assert faults[-1].sentence == "and 37 more: missing files"


def test_errors_come_before_warnings(root: Path) -> None:
    copied_intrinsic(root)
    image(root).unlink()
    assert [fault.severity for fault in check_tables(root)] == ["error", "warning", "warning"]


def test_variants_are_checked_one_by_one(tmp_path: Path) -> None:
    write_root(tmp_path, [short_scene(seconds=1.0)], layout="per-variant", renderer=None)
    assert check_tables(tmp_path) == []
    (tmp_path / "v0" / VERSION / "sensor.json").unlink()
    assert check_tables(tmp_path)[0].table == "v0/sensor"


def test_roots_that_cannot_be_checked(root: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder"):
        check_tables(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no nuScenes tables"):
        check_tables(tmp_path / "empty")
    shutil.copytree(root / VERSION, root / "v1.0-mini")
    with pytest.raises(InputError, match="several versions"):
        check_tables(root)
    with pytest.raises(InputError, match=r"versions there: v1\.0-mini, v1\.0-trainval"):
        check_tables(root, version="v2")


def test_maps_may_list_logs_of_other_versions(root: Path) -> None:
    edit(root, "map", lambda rows: rows[0]["log_tokens"].append("a log of the full data set"))
    assert check_tables(root) == []


@pytest.mark.parametrize(
    ("name", "expected", "limit"),
    [
        ("lyft_v1.01_tables_mmdet3d_tests", "nbr_annotations is 103, but the instance has 1 annotation", 90),
        ("thirdparty_nuscenes_format_hudang", "rotation is [[1.0, 0.0, 0.0]", 70),
        ("scene0061_tables_v1.0-test", "instance.json is missing", 50),
    ],
)
def test_real_malformed_tables(name: str, expected: str, limit: int) -> None:
    folder = SHARED / "data/nuscenes" / name
    if not folder.is_dir():
        pytest.skip("the shared data is not beside the repository")
    faults = check_tables(folder)
    assert any(expected in fault.sentence for fault in faults)
    assert len(faults) < limit
    assert all(len(fault.sentence) < 250 for fault in faults)
