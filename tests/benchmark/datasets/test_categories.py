"""Names of categories that are not nuScenes': ready maps, files, and what a root is with them."""

import json
from pathlib import Path

import pytest

from benchmark.constants import CATEGORIES
from benchmark.datasets.categories import READY, read_categories, select_category_names
from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from tests.benchmark.edited_roots import copy_of, rename_categories


@pytest.mark.parametrize("name", READY)
def test_ready_maps_lead_to_categories_of_nuscenes_and_leave_those_alone(name: str) -> None:
    assert set(READY[name].values()) <= set(CATEGORIES)
    assert select_category_names(CATEGORIES, read_categories(name)) == ()
    assert dict(select_category_names(READY[name], read_categories(name))) == {
        own: to for own, to in READY[name].items() if own != to
    }


@pytest.mark.parametrize(
    ("given", "own", "meant"),
    [
        ("short", "CAR", "vehicle.car"),
        ("short", "Traffic Cone", "movable_object.trafficcone"),
        ("short", "vehicle_bus_rigid", "vehicle.bus.rigid"),
        ("short", "VEHICLE.CAR", "vehicle.car"),
        ("lyft", "other_vehicle", "vehicle.construction"),
        ("t4", "vehicle.emergency (ambulance & police)", "vehicle.emergency.ambulance"),
        ("argoverse2", "REGULAR_VEHICLE", "vehicle.car"),
        ("argoverse2", "Regular_vehicle", "vehicle.car"),
    ],
)
def test_names_are_found_whatever_their_case_and_what_stands_between_words(given: str, own: str, meant: str) -> None:
    assert select_category_names([own, "no such thing"], read_categories(given)) == ((own, meant),)


def test_a_file_of_names(tmp_path: Path) -> None:
    path = tmp_path / "names.json"
    path.write_text('{"Pkw": "vehicle.car"}')
    assert select_category_names(["Pkw", "Lkw"], read_categories(str(path))) == (("Pkw", "vehicle.car"),)
    for content, word in (
        ("[]", "is not a JSON object"),
        ("{}", "is not a JSON object"),
        ('{"Pkw": "car"}', "maps 'Pkw' to 'car'"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=word):
            read_categories(str(path))
    with pytest.raises(InputError, match="did you mean lyft"):
        read_categories("lift")


def test_a_root_with_replaced_names_has_the_scenes_of_the_root_with_nuscenes_names(town: Path, tmp_path: Path) -> None:
    foreign = copy_of(town, tmp_path / "foreign")
    rename_categories(foreign, lambda name: name.replace(".", "_").upper())
    as_it_is, meant = open_data(foreign), open_data(foreign, categories=read_categories("short"))
    (name,) = meant.scene_names()
    original = open_data(town)
    assert meant.scene(name).agents.categories == original.scene(name).agents.categories
    assert dict(meant.categories)["VEHICLE_CAR"] == "vehicle.car"
    assert meant.annotation_counts([name]) == original.annotation_counts([name])
    counts = as_it_is.annotation_counts([name])[name]
    assert counts.is_mostly_unknown and sum(counts.unknown.values()) == counts.annotations > 0
    # Planners that see objects go by categories, so that plans on the one are none on the other.
    assert len({as_it_is.fingerprint(), meant.fingerprint()}) == 2
    assert as_it_is.with_categories(meant.categories).fingerprint() == meant.fingerprint()
    assert open_data(town, categories=read_categories("short")).fingerprint() == original.fingerprint()


def test_few_unknown_categories_are_counted_and_named(town: Path, tmp_path: Path) -> None:
    root = copy_of(town, tmp_path / "few")
    rows = json.loads(next(root.glob("*/sample_annotation.json")).read_text())
    rename_categories(root, lambda name: "moped" if name == "human.pedestrian.child" else name)
    data = open_data(root)
    (name,) = data.scene_names()
    counts = data.annotation_counts([name])[name]
    assert counts.annotations == len(rows) and list(counts.unknown) == ["moped"]
    assert f"{counts.unknown['moped']:,} of {counts.annotations:,} annotations" in counts.sentence
    assert "('moped')" in counts.sentence
