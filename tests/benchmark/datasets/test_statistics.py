"""The paper's data-set table and the distribution of manoeuvres, counted from tables."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.statistics import statistics
from benchmark.datasets.stored_rows import count_rows
from benchmark.errors import InputError
from benchmark.published import ADV_NUSC
from benchmark.records.statistics import TableCounts
from tests.benchmark.datasets.nuscenes_tables import VERSION, TinyRoot
from tests.hand_made import Car, scene_on_straight_road

NAMES = ("scene-9901", "scene-9902", "scene-9903")


def tiny(root: Path, names: Sequence[str] = NAMES) -> TinyRoot:
    """Scenes of 2, 3 and 4 s with one, two and three cars."""
    scenes = []
    for number, name in enumerate(names, start=1):
        cars = tuple(Car(80.0 + 10 * index, 198.25, 8.0) for index in range(number))
        scenes.append(scene_on_straight_road(cars, name=name, seconds=1.0 + number))
    return TinyRoot.of(root, scenes)


def labels(manoeuvre: str, place: str, gap_m: float, seconds: float | None, *others: str) -> dict[str, Any]:
    return {
        "manoeuvre": manoeuvre, "place": place,
        "occurred": [
            {"kind": kind, "first_s": 0.0, "duration_s": 1.0, "least_gap_m": gap_m} for kind in (manoeuvre, *others)
        ],
        "closest_approach": {"gap_m": gap_m, "frame": 12, "time_s": 1.0, "side": "left"},
        "time_to_collision": None if seconds is None else {"seconds": seconds, "time_s": 1.0}, "encroachment": None,
    }  # fmt: skip


def generated(root: Path) -> Path:
    """A root of three generated scenes, one with two adversaries."""
    tiny(root).write()
    made = {
        NAMES[0]: {"adversaries": ["a"], "report": {"kept": True, "labels": labels("blocking", "bend", 1.0, 2.0)}},
        NAMES[1]: {
            "adversaries": ["a", "b"],
            "report": {
                "adversaries": [
                    {"labels": labels("tailgating", "junction", 3.0, None, "blocking")},
                    {"labels": labels("blocking", "junction", 2.0, 1.0)},
                ]
            },
        },
        NAMES[2]: {"adversaries": ["a"], "report": {"labels": None}},
    }
    (root / VERSION / "challenger.json").write_text(json.dumps({"split": "adv", "scenes": made}))
    return root


def by_hand(made: TinyRoot, names: Sequence[str]) -> TableCounts:
    """The slow, obvious count."""
    tables = made.tables
    scenes = [row["token"] for row in tables["scene"] if row["name"] in names]
    samples = [row["token"] for row in tables["sample"] if row["scene_token"] in scenes]
    data = [row for row in tables["sample_data"] if row["sample_token"] in samples]
    notes = [row for row in tables["sample_annotation"] if row["sample_token"] in samples]
    return TableCounts(
        instances=sum(any(note["instance_token"] == row["token"] for note in notes) for row in tables["instance"]),
        ego_poses=sum(any(one["ego_pose_token"] == row["token"] for one in data) for row in tables["ego_pose"]),
        scenes=len(scenes), samples=len(samples), sample_data=len(data), annotations=len(notes),
    )  # fmt: skip


def test_the_published_table_is_quoted_as_printed() -> None:
    assert TableCounts(
        instances=12_858, ego_poses=254_436, scenes=156, samples=6_115, sample_data=254_436, annotations=225_085
    ) == TableCounts(**ADV_NUSC)


@pytest.mark.parametrize("names", [NAMES[:1], NAMES[1:], NAMES])
def test_a_split_has_the_rows_of_its_scenes(tmp_path: Path, names: tuple[str, ...]) -> None:
    made = tiny(tmp_path)
    made.write()
    (tmp_path / VERSION / "splits.json").write_text(json.dumps({"some": names}))
    found = statistics(tmp_path, split="some")
    assert found.counts == by_hand(made, names)
    assert found.counts.samples == sum(2 * (2 + NAMES.index(name)) for name in names)
    assert (found.labelled, found.manoeuvres, found.adversaries_per_scene) == (0, (), {})


def test_without_a_split_every_row_counts(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    made.tables["ego_pose"].append({"token": "of nobody", "translation": [0, 0, 0], "rotation": [1, 0, 0, 0]})
    made.tables["instance"].append({"token": "never seen", "category_token": "cat-vehicle.car"})
    made.write()
    every, val = statistics(tmp_path).counts, statistics(tmp_path, split="val").counts
    assert every.ego_poses == len(made.tables["ego_pose"]) == val.ego_poses + 1
    assert every.instances == len(made.tables["instance"]) == val.instances + 1
    assert every.sample_data == len(made.tables["sample_data"]) == val.sample_data


@pytest.mark.parametrize("table", ["instance", "ego_pose", "sample", "sample_data", "sample_annotation", "scene"])
def test_a_row_that_stands_twice_is_refused(tmp_path: Path, table: str) -> None:
    made = tiny(tmp_path)
    made.tables[table].append(made.tables[table][-1])
    made.write()
    with pytest.raises(InputError, match=rf"{table}\.json has two rows with the same token"):
        statistics(tmp_path)


def test_variant_roots_are_summed(tmp_path: Path) -> None:
    first, second = tiny(tmp_path / "v0"), tiny(tmp_path / "v1", NAMES[:1])
    first.write()
    second.write()
    found = statistics(tmp_path, split="val").counts
    one, other = by_hand(first, NAMES), by_hand(second, NAMES)
    assert (found.scenes, found.samples) == (4, one.samples + other.samples)
    assert found.instances == one.instances + other.instances


def test_neither_maps_nor_images_are_needed(tmp_path: Path) -> None:
    made = tiny(tmp_path)
    made.write()
    shutil.rmtree(tmp_path / "maps")
    assert statistics(tmp_path).counts == by_hand(made, NAMES)


def test_manoeuvres_are_counted_over_all_adversaries(tmp_path: Path) -> None:
    found = statistics(generated(tmp_path), split="adv")
    assert found.adversaries_per_scene == {1: 2, 2: 1}
    assert (found.labelled, found.places) == (3, {"junction": 2, "bend": 1})
    blocking, tailgating = found.manoeuvres
    assert (blocking.manoeuvre, blocking.primary, blocking.occurred) == ("blocking", 2, 3)
    assert (blocking.places, blocking.median_gap_m) == ({"bend": 1, "junction": 1}, 1.5)
    assert (tailgating.manoeuvre, tailgating.primary, tailgating.occurred) == ("tailgating", 1, 1)
    assert found.gap_m is not None
    assert tuple(found.gap_m.model_dump().values()) == pytest.approx((1.0, 1.2, 2.0, 2.8, 3.0))
    assert found.time_to_collision_s is not None
    assert (found.within_5_s, found.time_to_collision_s.median) == (2, 1.5)


def test_only_the_split_s_scenes_are_described(tmp_path: Path) -> None:
    generated(tmp_path)
    (tmp_path / VERSION / "splits.json").write_text(json.dumps({"first": [NAMES[0]]}))
    found = statistics(tmp_path, split="first")
    assert (found.labelled, found.adversaries_per_scene) == (1, {1: 1})
    assert [row.manoeuvre for row in found.manoeuvres] == ["blocking"]


def test_text_and_json_say_the_same(tmp_path: Path) -> None:
    found = statistics(generated(tmp_path), split="adv")
    value = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert value["counts"]["scenes"] == 3 and value["published_adv_nusc"]["scenes"] == 156
    text = found.plain()
    assert text.splitlines()[0] == f"{tmp_path}, split adv"
    assert any(line.split() == ["scenes", "3", "156"] for line in text.splitlines())
    assert any(line.split() == ["blocking", "2", "3", "1", "1", "1.50", "m"] for line in text.splitlines())
    assert any(line.split() == ["all", "3", "2", "1"] for line in text.splitlines())
    assert max(map(len, text.splitlines()[1:])) < 100
    recorded = statistics(generated(tmp_path), split=None)
    assert "all scenes" in recorded.plain()


ROW = '{"token": "a", "scene_token": "b"}'


@pytest.mark.parametrize(
    ("table", "content", "sentence"),
    [
        ("sample", '[{"token": "a", "scene_token": "b"}, {"token"', "not a JSON list of rows"),
        ("sample", '[{"token": "a", "scene_token": "b"}', "not a JSON list of rows"),
        ("sample", "", "not a JSON list of rows"),
        ("sample", "[{}{}]".replace("{}", ROW), "not a JSON list of rows .*no comma"),
        ("sample", "[{},,{}]".replace("{}", ROW), "not a JSON list of rows"),
        ("sample", "[{},]".replace("{}", ROW), "not a JSON list of rows"),
        ("sample", "[{}] [{}]".replace("{}", ROW), "not a JSON list of rows .*more than one"),
        ("sample", "[" * 100_000, "not a JSON list of rows"),
        ("sample", '{"token": "a"}', "not a JSON list of rows"),
        ("sample", '[{"token": "a"}]', "row 0 is not an object with token and scene_token"),
        ("sample", "[17]", "not a JSON list of rows"),
        ("sample", '[{"token": "\xff"}]', "not a JSON list of rows"),
        ("ego_pose", '[{"token": 5}]', "row 0 is not an object"),
        ("scene", '[{"token": "a", "name": null}]', "row 0 is not an object"),
    ],
)
def test_broken_tables_are_one_sentence(tmp_path: Path, table: str, content: str, sentence: str) -> None:
    tiny(tmp_path).write()
    (tmp_path / VERSION / f"{table}.json").write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=sentence) as raised:
        statistics(tmp_path)
    assert f"{table}.json" in str(raised.value) and "\n" not in str(raised.value)


def test_wrong_roots_splits_and_labels_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder"):
        statistics(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="not a folder"):
        statistics(tmp_path / "file")
    root = generated(tmp_path / "root")
    with pytest.raises(InputError, match="no split 'test'"):
        statistics(root, split="test")
    path = root / VERSION / "challenger.json"
    value = json.loads(path.read_text())
    del value["scenes"][NAMES[0]]["report"]["labels"]["closest_approach"]["gap_m"]
    path.write_text(json.dumps(value))
    with pytest.raises(InputError, match=r"labels of scene-9901 lack a proper closest_approach\.gap_m"):
        statistics(root)
    value["scenes"][NAMES[0]]["report"]["labels"] = "blocking"
    path.write_text(json.dumps(value))
    with pytest.raises(InputError, match="labels of scene-9901"):
        statistics(root)
    damaged: tuple[Any, ...] = ([], {"scenes": []}, {"scenes": {"a": {"adversaries": 3}}})
    for broken in damaged:
        path.write_text(json.dumps(broken))
        with pytest.raises(InputError, match="must be an object with its scenes"):
            statistics(root)


def test_counting_needs_no_scene_to_be_there(tmp_path: Path) -> None:
    tiny(tmp_path).write()
    assert count_rows(tmp_path / VERSION, ()) == TableCounts(**dict.fromkeys(ADV_NUSC, 0))
