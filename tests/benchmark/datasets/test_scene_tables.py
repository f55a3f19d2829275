import json
import random
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.datasets import devkit, scene_tables, stored_rows
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.scene_tables import GROWING_TABLES
from benchmark.datasets.stored_rows import TableScan
from benchmark.errors import InputError
from tests.benchmark.datasets.nuscenes_tables import VERSION, TinyRoot
from tests.hand_made import scene_on_straight_road

NAMES = ("scene-9901", "scene-9902", "scene-9903")
ROWS = st.lists(st.dictionaries(st.text(max_size=4), st.text(max_size=6) | st.floats(allow_nan=False), max_size=3))


def shuffled(root: Path) -> TinyRoot:
    """Three scenes whose rows lie in no order."""
    made = TinyRoot.of(root, [scene_on_straight_road(name=name, seconds=3.0) for name in NAMES])
    for table in GROWING_TABLES:
        random.Random(table).shuffle(made.tables[table])
    return made


@pytest.fixture
def tables(tmp_path: Path) -> TinyRoot:
    return shuffled(tmp_path)


@pytest.fixture
def whole(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], NuScenesData]:
    """Opens a data set as the devkit does, all rows in memory: the obvious way."""

    def opened(root: Path) -> NuScenesData:
        with monkeypatch.context() as context:
            context.setattr(devkit, "read_tables_cached", lambda *_: None)
            data = NuScenesData.open(root)
        assert isinstance(data._tables, devkit.AllSceneTables)
        return data

    return opened


def parts(value: Any) -> Iterator[Any]:
    """Everything that a value is made of, comparable; how an image is loaded is left out."""
    if is_dataclass(value):
        for part in fields(value):
            yield from parts(None if part.name == "load" else getattr(value, part.name))
    elif isinstance(value, np.ndarray):
        yield value.shape, value.dtype.str, value.tobytes()
    elif isinstance(value, list | tuple):
        yield len(value)
        for part in value:
            yield from parts(part)
    elif isinstance(value, dict):
        yield from parts(list(value.items()))
    else:
        yield value


def everything(data: NuScenesData) -> Iterator[Any]:
    for name in data.scene_names():
        yield from parts((data.scene(name), list(data.observations(name)), data.truth(name), data.has_map(name)))
    yield from (data.fingerprint(), data.splits(), data.provenance())


def foreign_letters(tables: TinyRoot) -> None:
    tables.tables["scene"][1]["description"] = "Kreuzung, Straße \u2028 naß \U0001f697"
    tables.tables["sample_annotation"][0]["note"] = "naß"
    tables.write()
    for table in ("sample_annotation", "scene"):
        path = tables.root / VERSION / f"{table}.json"
        path.write_text(json.dumps(tables.tables[table], ensure_ascii=False, indent=1), encoding="utf-8")


def no_objects(tables: TinyRoot) -> None:
    tables.tables["instance"], tables.tables["sample_annotation"] = [], []
    tables.write()


@pytest.mark.parametrize("change", [foreign_letters, no_objects])
def test_scene_by_scene_gives_what_the_whole_tables_give(
    tables: TinyRoot, whole: Callable[[Path], NuScenesData], change: Callable[[TinyRoot], None]
) -> None:
    change(tables)
    data = NuScenesData.open(tables.root)
    assert isinstance(data._tables, devkit.PerSceneTables)
    assert (not data.scene("scene-9902").agents.ids) == (change is no_objects)
    assert list(everything(data)) == list(everything(whole(tables.root)))


def test_the_devkit_holds_the_rows_of_one_scene(tables: TinyRoot) -> None:
    data = NuScenesData.open(tables.write())
    nusc = data._tables.of_scene(data._row("scene-9902"))
    [scene] = [row for row in tables.tables["scene"] if row["name"] == "scene-9902"]
    samples = {row["token"] for row in tables.tables["sample"] if row["scene_token"] == scene["token"]}
    assert {row["token"] for row in nusc.sample} == samples
    for table in GROWING_TABLES:
        assert len(getattr(nusc, table)) * len(NAMES) == len(tables.tables[table]), table
    for table in ("sample_data", "sample_annotation"):
        mine = [row["token"] for row in tables.tables[table] if row["sample_token"] in samples]
        assert [row["token"] for row in getattr(nusc, table)] == mine


def test_sweeps_that_go_on_into_the_next_scene_are_refused(tables: TinyRoot) -> None:
    scene_of = {row["token"]: row["scene_token"] for row in tables.tables["sample"]}
    first, *others = (row for row in tables.tables["sample_data"] if not row["next"])
    here = scene_of[first["sample_token"]]
    first["next"] = next(end["token"] for end in others if scene_of[end["sample_token"]] != here)
    with pytest.raises(InputError, match=f"row {first['token']}: next {first['next']} is a row of another scene"):
        NuScenesData.open(tables.write())


def test_tables_with_rows_that_only_the_devkit_reads_are_read_whole(
    tables: TinyRoot, whole: Callable[[Path], NuScenesData]
) -> None:
    root = tables.write()
    (root / VERSION / "image_annotations.json").write_text("[]")
    data = NuScenesData.open(root)
    assert isinstance(data._tables, devkit.AllSceneTables)
    assert list(everything(data)) == list(everything(whole(root)))
    (root / VERSION / "image_annotations.json").unlink()
    assert list(everything(data)) == list(everything(NuScenesData.open(root)))


def test_tokens_with_one_hash_are_read_whole(
    tables: TinyRoot, whole: Callable[[Path], NuScenesData], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene_tables, "hash", lambda text: len(text), raising=False)
    data = NuScenesData.open(tables.write())
    assert isinstance(data._tables, devkit.AllSceneTables)
    assert list(everything(data)) == list(everything(whole(tables.root)))


def test_tables_that_change_behind_the_back_are_a_sentence(tables: TinyRoot) -> None:
    root = tables.write()
    data = NuScenesData.open(root)
    data.scene("scene-9901")
    tables.tables["ego_pose"].reverse()
    tables.write()
    with pytest.raises(InputError, match=r"\.json has changed since it was opened; run the command again"):
        data.scene("scene-9902")


@given(
    rows=ROWS,
    indent=st.sampled_from([None, 0, 2]),
    ascii_only=st.booleans(),
    chunk=st.integers(1, 40),
    cut=st.none() | st.tuples(st.integers(0, 10**6), st.integers(0, 2), st.sampled_from(["", ",", "]", "}", "[", "x"])),
)
def test_rows_are_those_of_json_or_none(
    tmp_path_factory: pytest.TempPathFactory,
    rows: list[dict[str, Any]],
    indent: int | None,
    ascii_only: bool,
    chunk: int,
    cut: tuple[int, int, str] | None,
) -> None:
    """Read in small pieces, damaged or not: what the standard library refuses is refused, the rest is the same."""
    text = json.dumps(rows, indent=indent, ensure_ascii=ascii_only)
    if cut is not None:
        place, length, instead = cut[0] % len(text), cut[1], cut[2]
        text = text[:place] + instead + text[place + length :]
    path = tmp_path_factory.getbasetemp() / "rows.json"
    path.write_bytes(text.encode())
    try:
        expected = json.loads(text)
    except ValueError:
        expected = None
    if not isinstance(expected, list) or not all(isinstance(row, dict) for row in expected):
        expected = None
    reading = TableScan(path)
    with pytest.MonkeyPatch.context() as context:
        context.setattr(stored_rows, "_CHUNK_BYTES", chunk)
        context.setattr(stored_rows, "_BATCH_ROWS", 2)
        context.setattr(stored_rows, "_READ_THROUGH_BYTES", chunk)
        if expected is None:
            with pytest.raises(InputError, match="is not a JSON list of rows"):
                list(reading.batches())
            return
        assert [row for batch in reading.batches() for row in batch] == expected
        stored = reading.stored()
        assert stored.read(np.arange(len(expected))) == expected
        assert stored.read(np.arange(0, len(expected), 2)) == expected[::2]
