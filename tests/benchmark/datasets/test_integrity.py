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


def edit(root: Path, table: str, change: Callable[[Any], object]) -> None:
    """Change the content of a table in place."""
    path = root / VERSION / f"{table}.json"
    rows = json.loads(path.read_text())
    change(rows)
    path.write_text(json.dumps(rows))


def image(root: Path) -> Path:
    return sorted(root.glob("samples/CAM_FRONT/*.jpg"))[0]


def circle(rows: Rows) -> None:
    rows[0]["prev"], rows[2]["next"] = rows[2]["token"], rows[0]["token"]


def two_chains(rows: Rows) -> None:
    rows[1]["next"], rows[2]["prev"] = "", ""


def later(row: int, by_us: int) -> Callable[[Rows], None]:
    return lambda rows: rows[row].update(timestamp=rows[row]["timestamp"] + by_us)


def copied(row: int, field: str, source: str | None = None, of: int = 0) -> Callable[[Rows], None]:
    """One row gets what another one, the first, has in the field, or in another one."""
    return lambda rows: rows[row].update({field: rows[of][source or field]})


def copied_intrinsic(rows: Rows) -> None:
    cameras = [row for row in rows if row["camera_intrinsic"]]
    for row in cameras:
        row["camera_intrinsic"] = cameras[0]["camera_intrinsic"]


PLANTED_ROWS: dict[str, tuple[str, Callable[[Rows], None], str]] = {
    "one-way link": ("sample", copied(1, "prev", "token", of=2), "but prev of that row"),
    "circle": ("sample", circle, "form a cycle"),
    "two chains": ("sample_data", two_chains, "are reached from its first one"),
    "into another scene": ("sample", copied(2, "next", "token", of=3), "is not a row of scene"),
    "annotation count": ("instance", lambda rows: rows[1].update(nbr_annotations=2), "nbr_annotations is 2"),
    "first sample": ("scene", copied(0, "first_sample_token", "last_sample_token"), "the first is"),
    "last annotation": ("instance", copied(0, "last_annotation_token", "first_annotation_token"), "the last is"),
    "annotated twice": ("sample_annotation", copied(1, "sample_token"), "another annotation at sample"),
    "sensor twice": ("sample_data", copied(1, "sample_token"), "2 keyframe rows of LIDAR_TOP"),
    "no keyframe row": ("sample_data", lambda rows: rows[4].update(is_key_frame=False), "no keyframe row of"),
    "late keyframe": ("sample_data", later(2, 150_000), "0.15 s away from its sample"),
    "late pose": ("ego_pose", later(2, -150_000), "ego pose is from 0.15 s away"),
    "copied intrinsic": ("calibrated_sensor", copied_intrinsic, "as if it were copied"),
    "same scene name": ("scene", copied(1, "name"), "2 rows have the name"),
    "same file": ("sample_data", copied(1, "filename"), "also belongs to"),
    "image size": ("sample_data", lambda rows: rows[5].update(width=33), "32 x 18 pixels, the row says 33 x 18"),
    "log without map": ("map", lambda rows: rows[0]["log_tokens"].pop(0), "no map has this log"),
    "weak adversary": (
        "sample_annotation", lambda rows: rows[1].update(num_lidar_pts=0, num_radar_pts=9), "claims no lidar point"
    ),
}  # fmt: skip
"""Changes of a table's rows, and what is said of it."""
BLAMED = {"sensor twice": "sample", "no keyframe row": "sample", "late pose": "sample_data", "log without map": "log"}
"""Tables that are blamed for the rows of another one."""


def walking_adversary(root: Path) -> None:
    categories = json.loads((root / VERSION / "category.json").read_text())
    walker = next(row["token"] for row in categories if row["name"] == "human.pedestrian.adult")
    edit(root, "instance", lambda rows: rows[0].update(category_token=walker))


def adversary(token: str) -> Callable[[Path], None]:
    def change(content: Any) -> None:
        content["scenes"]["scene-9901"]["adversaries"] = [token]

    return lambda root: edit(root, "challenger", change)


def foreign_adversary(root: Path) -> None:
    adversary(json.loads((root / VERSION / "instance.json").read_text())[-1]["token"])(root)


def forgotten_scene(root: Path) -> None:
    edit(root, "challenger", lambda content: content["scenes"].pop("scene-9902"))


def file(name: str, change: Callable[[bytes], bytes] | None) -> Callable[[Path], None]:
    """The first file of a pattern changes, or goes."""

    def act(root: Path) -> None:
        path = min(root.glob(name))
        path.unlink() if change is None else path.write_bytes(change(path.read_bytes()))

    return act


IMAGE, EXPANSION = "samples/CAM_FRONT/*.jpg", "maps/expansion/boston-seaport.json"
PLANTED_FILES: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "no image": ("sample_data", file(IMAGE, None), "is missing"),
    "empty image": ("sample_data", file(IMAGE, lambda _: b""), "is empty"),
    "truncated image": ("sample_data", file(IMAGE, lambda data: data[:-30]), "not a complete JPEG"),
    "no image at all": ("sample_data", file(IMAGE, lambda _: b"<html></html>"), "not a complete JPEG"),
    "half a point": ("sample_data", file("samples/LIDAR_TOP/*", lambda _: b"1234567"), "a whole number of points"),
    "no mask": ("map", file("maps/*.png", None), "is missing"),
    "half a mask": ("map", file("maps/*.png", lambda data: data[:500]), "not a complete PNG"),
    "no expansion": (EXPANSION, file(EXPANSION, None), "is missing"),
    "poor expansion": (EXPANSION, file(EXPANSION, lambda _: b'{"version": "1.3", "lane": []}'), "'node' is missing"),
    "unknown split scene": ("splits.json", file("*/splits.json", lambda _: b'{"adv": ["scene-1"]}'), "scene-1"),
    "split no list": ("splits.json", file("*/splits.json", lambda _: b'{"adv": "scene-9901"}'), "must be a list"),
    "walking adversary": ("challenger.json", walking_adversary, "human.pedestrian.adult, not a vehicle"),
    "unknown adversary": ("challenger.json", adversary("gone"), "not in instance.json"),
    "foreign adversary": ("challenger.json", foreign_adversary, "annotated in another scene"),
    "forgotten scene": ("challenger.json", forgotten_scene, "is in scene.json but not in"),
    "broken provenance": ("challenger.json", file("*/challenger.json", lambda _: b"[1,"), "cannot be read"),
}
WARNINGS = {"copied intrinsic", "no expansion", "same file"}


def test_nothing_wrong_with_what_the_writer_writes(sound: Path) -> None:
    assert check_tables(sound) == []
    assert check_tables(sound, version=VERSION) == []
    assert check_tables(sound / VERSION) == check_tables(sound / VERSION, version=None)


@pytest.mark.parametrize("name", [*PLANTED_ROWS, *PLANTED_FILES])
def test_planted_fault(root: Path, name: str) -> None:
    """Single rows and values that are wrong by themselves are in `test_bad_tables`."""
    if name in PLANTED_ROWS:
        table, change, words = PLANTED_ROWS[name]
        edit(root, table, change)
    else:
        table, plant, words = PLANTED_FILES[name]
        plant(root)
    faults = check_tables(root)
    found = [fault for fault in faults if fault.table == BLAMED.get(name, table) and words in fault.sentence]
    assert found, faults
    assert {fault.severity for fault in found} == {"warning" if name in WARNINGS else "error"}


def test_every_table_may_be_missing_or_garbage(root: Path) -> None:
    garbage = (None, b"", b"null", b"[[]]", b'[{"token": "a"}]', b"\xff\xfe", b'[{"token": "a", "ti')
    for number, table in enumerate(NUSCENES_TABLES):
        path = root / VERSION / f"{table}.json"
        whole = path.read_bytes()
        # Every content in some tables, every table with some contents.
        for content in (None, garbage[1 + number % 6], garbage[1 + (number + 3) % 6]):
            path.unlink(missing_ok=True)
            if content is not None:
                path.write_bytes(content)
            assert any(fault.table == table for fault in check_tables(root)), (table, content)
        path.write_bytes(whole)
    assert check_tables(root) == []


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 5), st.floats(), st.text(max_size=3),
    st.lists(st.floats() | st.text(max_size=2), max_size=4),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
)  # fmt: skip


@settings(max_examples=20, deadline=None)
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
    edit(root, "calibrated_sensor", copied_intrinsic)
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
