"""What is refused when a data set is opened and read, the check reports; both read the same text."""

import shutil
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from random import Random

import numpy as np
import pytest

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.schema.check import check_tables
from benchmark.errors import InputError
from tests.benchmark.datasets.nuscenes_tables import VERSION, TinyRoot
from tests.benchmark.edited_roots import copy_of, version_of
from tests.benchmark.untrusted.mutations import FORMS
from tests.hand_made import scene_on_straight_road

SEEDS = 3
"""Mutations of each file: a sample of seconds; `bench/attack.py` tries as many as one likes."""
OTHER_ENCODINGS = {"utf-16": "UTF-16", "utf-16-le": "UTF-16", "utf-16-be": "UTF-16", "utf-32": "UTF-32"}
TEXTS = [f"{VERSION}/{table}.json" for table in NUSCENES_TABLES]
TEXTS += ["splits.json", "maps/expansion/*.json", "can_bus/*_pose.json"]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scenes = [scene_on_straight_road(seconds=2.0), scene_on_straight_road(seconds=1.0, name="scene-9902")]
    made = TinyRoot.of(tmp_path_factory.mktemp("tiny"), scenes, sweeps=False)
    root = made.write()
    made.write_images((1600, 900))
    for row in made.tables["sample_data"]:
        path = root / row["filename"]
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            path.write_bytes(bytes(20))
    (root / "splits.json").write_text('{"mine": ["scene-9901"], "others": ["scene-9902"]}')
    return root


def read_whole(root: Path) -> None:
    """All that an evaluation reads of a root."""
    data = NuScenesData.open(root)
    data.fingerprint()
    for name in data.scene_names():
        data.scene(name)
        assert len(data.truth(name)) == len(list(data.observations(name)))


def refused(root: Path) -> str | None:
    try:
        read_whole(root)
    except InputError as error:
        return str(error)
    return None


def errors(root: Path) -> list[str]:
    return [fault.sentence for fault in check_tables(root) if fault.severity == "error"]


@pytest.mark.parametrize(("name", "encoding"), list(zip(TEXTS, cycle(OTHER_ENCODINGS))))
def test_other_encodings_are_named_by_both(tiny: Path, town: Path, tmp_path: Path, name: str, encoding: str) -> None:
    source = tiny if any(tiny.glob(name)) else town
    root = copy_of(source, tmp_path / "root")
    path = min(root.glob(name))
    text = path.read_text()
    path.unlink()
    path.write_text(text, encoding=encoding)
    said = f"it is text in {OTHER_ENCODINGS[encoding]}, save it as UTF-8"
    sentence = refused(root)
    assert sentence is not None and said in sentence and path.name in sentence
    assert any(said in one for one in errors(root))


def test_a_mark_before_utf_8_is_read_by_both(tiny: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(tiny, tmp_path / "root"))
    before = check_tables(root)
    for path in (*root.glob(f"{VERSION}/*.json"), root / "splits.json"):
        # Letters of two bytes: rows are found again by their places in bytes.
        path.write_text(path.read_text().replace("Straight road", "Gerade Straße"), encoding="utf-8-sig")
    assert check_tables(root) == before
    marked, plain = NuScenesData.open(root), NuScenesData.open(tiny)
    assert marked.splits() == plain.splits()
    for name in plain.scene_names():
        one, other = marked.scene(name), plain.scene(name)
        assert one.description == other.description.replace("Straight road", "Gerade Straße")
        np.testing.assert_array_equal(one.ego.position, other.ego.position)
        np.testing.assert_array_equal(one.annotations.position, other.annotations.position)


def tried(source: Path, target: Path, files: Sequence[str], seeds: int) -> list[str]:
    """Mutations of files that are refused when the root is read and pass the check."""
    missed, refusals = [], 0
    for name in files:
        content = (source / name).read_bytes()
        for seed in range(seeds):
            chance = Random(f"{name} {seed}")
            mutation = chance.choice(FORMS["json"])
            changed = mutation.change(content, chance)
            if changed == content:
                continue
            (target / name).write_bytes(changed)
            sentence = refused(target)
            if sentence is not None:
                refusals += 1
                if not errors(target):
                    missed.append(f"{name}, seed {seed}, {mutation.name}: {sentence}")
        (target / name).write_bytes(content)
    assert refusals > 0.3 * len(files) * seeds, "the mutations hardly break anything"
    return missed


def test_what_reading_refuses_the_check_reports(tiny: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(tiny, tmp_path / "root"))
    assert refused(root) is None and errors(root) == []
    files = [*(f"{VERSION}/{table}.json" for table in NUSCENES_TABLES), "splits.json"]
    assert tried(tiny, root, files, SEEDS) == []


def test_tables_that_only_the_devkit_reads_are_checked_by_it(tiny: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(tiny, tmp_path / "root"))
    (root / VERSION / "lidarseg.json").write_text("[]")
    sentence = refused(root)
    assert sentence is not None and "the category.json that comes with" in sentence
    assert errors(root) == [sentence]


def test_the_same_of_maps_can_bus_and_provenance(town: Path, tmp_path: Path) -> None:
    root = copy_of(town, tmp_path / "root")
    assert refused(root) is None and errors(root) == []
    location, *_ = root.glob("maps/expansion/*.json")
    (motion, *_), (steering, *_) = (
        sorted(root.glob(f"can_bus/*_{name}.json")) for name in ("pose", "steeranglefeedback")
    )
    provenance = root / version_of(root) / "challenger.json"
    files = [str(path.relative_to(root)) for path in (location, motion, steering, provenance) if path.is_file()]
    assert tried(root, root, files, 2) == []
