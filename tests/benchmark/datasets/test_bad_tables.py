import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.roots import open_data
from benchmark.datasets.schema import Fault
from benchmark.datasets.schema.check import check_tables
from benchmark.datasets.split_names import BORROWED_NAMES, select_scenes
from benchmark.errors import InputError
from tests.benchmark.datasets.hostile_tables import HOSTILE_ROOTS, HostileRoot
from tests.benchmark.datasets.nuscenes_tables import VERSION, TinyRoot
from tests.hand_made import scene_on_straight_road

SHARED = Path(__file__).resolve().parents[4] / "shared"


def tiny(root: Path) -> TinyRoot:
    return TinyRoot.of(root, [scene_on_straight_road(seconds=2.0)])


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny(tmp_path_factory.mktemp("sound")).write()


@pytest.fixture(scope="module")
def missing_files(sound: Path) -> list[Fault]:
    """All that the check says of the sound root, which has no images."""
    return check_tables(sound)


@pytest.mark.parametrize("hostile", HOSTILE_ROOTS, ids=[hostile.name for hostile in HOSTILE_ROOTS])
def test_a_broken_root_is_refused_in_one_sentence_and_the_check_finds_why(
    sound: Path, missing_files: list[Fault], tmp_path: Path, hostile: HostileRoot
) -> None:
    root = Path(shutil.copytree(sound, tmp_path / "root"))
    hostile.damage(root)
    with pytest.raises(InputError, match=hostile.words) as caught:
        NuScenesData.open(root)
    sentence = str(caught.value)
    assert sentence.isprintable() and len(sentence) < 700
    errors = [fault for fault in check_tables(root) if fault.severity == "error" and fault not in missing_files]
    said = hostile.words.rpartition("]*: ")[2] if "]*: " in hostile.words else ""
    assert any(fault.table == hostile.table and re.search(said, fault.sentence) for fault in errors), errors
    assert all(fault.sentence.isprintable() and len(fault.sentence) < 400 for fault in errors)


def set_row(table: str, token: str, **values: object) -> Callable[[TinyRoot], None]:
    return lambda made: made.row(table, token).update(values)


def names_in_capitals(made: TinyRoot) -> None:
    made.tables["scene"][0]["name"], made.tables["scene"][1]["name"] = "town-a", "Town-A"


def scene_without_samples(made: TinyRoot) -> None:
    made.tables["scene"].append(dict(made.tables["scene"][0], token="empty", name="scene-9903", nbr_samples=0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            set_row("sample", "scene-9901-sample-2", scene_token="scene-9902-token"),
            "sample-1: next scene-9901-sample-2 is not a row of scene scene-9901-token",
        ),
        (
            set_row("sample", "scene-9902-sample-3", next="scene-9901-sample-0"),
            "sample-3: next scene-9901-sample-0 is not a row of scene scene-9902-token",
        ),
        (
            set_row("scene", "scene-9901-token", first_sample_token="scene-9902-sample-0"),
            "first_sample_token is scene-9902-sample-0, the first is scene-9901-sample-0",
        ),
        (names_in_capitals, "2 rows have the name"),
        (scene_without_samples, r"scene\.json row empty: no sample belongs to this scene"),
    ],
)
def test_samples_and_scenes_that_do_not_go_together_are_refused_when_opened(
    tmp_path: Path, change: Callable[[TinyRoot], None], message: str
) -> None:
    made = TinyRoot.of(tmp_path, [scene_on_straight_road(seconds=2.0, name=f"scene-990{n}") for n in (1, 2)])
    change(made)
    with pytest.raises(InputError, match=message):
        NuScenesData.open(made.write())


def no_keyframe_rows(made: TinyRoot) -> None:
    for row in made.tables["sample_data"]:
        row["is_key_frame"] = row["is_key_frame"] and row["sample_token"] != "scene-9901-sample-1"


def broken_object(made: TinyRoot) -> None:
    made.tables["sample_annotation"][1]["prev"] = ""


def other_scenes_object(made: TinyRoot) -> None:
    made.tables["sample_annotation"][1]["next"] = made.tables["sample_annotation"][-1]["token"]


def late_keyframe(made: TinyRoot) -> None:
    made.row("sample_data", "scene-9901-CAM_FRONT-6")["timestamp"] += 150_000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (no_keyframe_rows, "sample-1: the sample has no keyframe row of CAM_FRONT, LIDAR_TOP"),
        (broken_object, "but prev of that row is ''"),
        (other_scenes_object, r"is not in sample_annotation\.json among the rows of its scene"),
        (late_keyframe, "its ego pose is from 0.15 s away"),
    ],
)
@pytest.mark.parametrize("whole", [False, True])
def test_rows_of_a_scene_that_do_not_go_together_are_refused_when_it_is_read(
    tmp_path: Path, change: Callable[[TinyRoot], None], message: str, whole: bool
) -> None:
    made = TinyRoot.of(tmp_path, [scene_on_straight_road(seconds=2.0, name=f"scene-990{n}") for n in (1, 2)])
    change(made)
    root = made.write()
    if whole:
        (root / VERSION / "image_annotations.json").write_text("[]")
    data = NuScenesData.open(root)
    with pytest.raises(InputError, match=message):
        data.scene("scene-9901")
    assert len(data.truth("scene-9902")) == 4
    assert any(fault.severity == "error" for fault in check_tables(root))


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
    return select_scenes(split, present, custom or {}, where="here", built_as=built_as)


def test_split_rules() -> None:
    mini = ["scene-0061", "scene-0103", "scene-0553", "scene-0916"]
    assert splits("val", ["b", "a"], {"val": ["b"]}) == ("b",)
    assert splits("val", ["b", "a"]) == ("a", "b")
    for split in ("val", "mini_val", "borrowed-names", "mine"):
        with pytest.raises(InputError, match="are none of them; choose the data set that it was exported from"):
            splits(split, mini, {"mine": mini, "val": mini}, BORROWED_NAMES)
    assert splits("val", mini) == ("scene-0103", "scene-0553", "scene-0916")
    assert splits("mini_val", mini) == ("scene-0103", "scene-0916")
    assert splits("train", mini) == ("scene-0061",)
    published = ["scene-0003-b", "scene-0003-a"]
    assert splits("adv", published) == ("scene-0003-a", "scene-0003-b")
    with pytest.raises(InputError, match="it has mini_train, mini_val, train, train_detect, val"):
        splits("adv", mini)
    with pytest.raises(InputError, match="lists x in 'val'"):
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
    with pytest.raises(InputError, match=r"is not in \w+\.json|timestamp is 1556675185903083\.2, it must be a whole"):
        NuScenesData.open(tmp_path)
