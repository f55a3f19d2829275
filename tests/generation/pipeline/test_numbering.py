"""Generated roots number their scenes and move variants apart in time, for the devkit's tutorial alone."""

import io
import json
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from benchmark.datasets.can_bus import CanBus
from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scene_names import read_names, read_scene_times
from benchmark.datasets.schema.check import check_tables
from benchmark.datasets.split_names import compute_shifts_us
from benchmark.datasets.statistics import list_scenes, statistics
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings
from benchmark.machine.storage import write_json
from benchmark.runs.scene_work import sort_as_published
from benchmark.scene import Scene
from generation.nuscenes_writer.numbering import number_scenes
from generation.pipeline import selection
from generation.pipeline.split import build_split
from generation.render.contract import Images
from generation.render.schematic import SchematicRenderer
from generation.splits.building import build_frozen
from generation.splits.packaged import read_frozen_split
from tests.generation.labels.recorded_roads import CHEAP, contents, write_source
from tests.hand_made import Car, scene_on_straight_road

matplotlib.use("Agg")
VERSION = "v1.0-mini"


class CountingRenderer(SchematicRenderer):
    """Counts the frames that it draws."""

    drawn = 0

    def render(self, scene: Scene, frames: Sequence[int]) -> Iterator[Images]:
        CountingRenderer.drawn += len(frames)
        return super().render(scene, frames)


QUICK = replace(CHEAP, renderer=CountingRenderer(96, 54), frames="keyframes")


def two_cars(name: str, ahead_m: float) -> Scene:
    """The ego, and two cars that get in its way, with cameras."""
    cars = (Car(52.0 + ahead_m, 194.75, 9.0), Car(60.0 + ahead_m, 194.75, 9.0))
    return scene_on_straight_road(cars, seconds=8.0, name=name)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_source(tmp_path_factory.mktemp("recorded"), two_cars("scene-9901", 10.0), two_cars("scene-9902", 2.0))


@pytest.fixture(scope="module")
def root(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root with variants of two recordings, and its frozen split beside it."""
    folder = tmp_path_factory.mktemp("generated")
    report = build_split(source, "adv", replace(QUICK, out=folder / "adv", freeze=folder / "road-adv-1.json"))
    assert len(report.written) > 2, "the tests need two variants of a recording"
    return folder / "adv"


@pytest.fixture(scope="module")
def nusc(root: Path) -> Any:
    from nuscenes import NuScenes

    return NuScenes(VERSION, str(root), verbose=False)


def test_the_tutorial_of_the_devkit(nusc: Any, root: Path, tmp_path: Path) -> None:
    listed = io.StringIO()
    with redirect_stdout(listed), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        nusc.list_scenes()
        nusc.list_categories()
        nusc.list_attributes()
        nusc.list_sample(nusc.sample[0]["token"])
    names = [line[:10] for line in listed.getvalue().splitlines() if line.startswith("scene-")]
    assert names == [f"scene-{2001 + place}" for place in range(len(nusc.scene))]
    sample = nusc.get("sample", nusc.scene[0]["first_sample_token"])
    # A box that ends at the plane of a camera is divided by its distance, 0, as the devkit does.
    with np.errstate(divide="ignore", invalid="ignore"):
        nusc.render_sample(sample["token"], out_path=str(tmp_path / "sample.png"), verbose=False)
        nusc.render_sample_data(sample["data"]["CAM_FRONT"], out_path=str(tmp_path / "camera.png"), verbose=False)
        nusc.render_annotation(sample["anns"][0], out_path=str(tmp_path / "annotation.png"))
        nusc.render_instance(nusc.instance[0]["token"], out_path=str(tmp_path / "instance.png"))
    nusc.render_egoposes_on_map(log_location="boston-seaport", out_path=str(tmp_path / "mask.png"))
    pyplot.close("all")
    assert len(list(tmp_path.glob("*.png"))) == 5


def test_the_tutorial_of_the_map_expansion(nusc: Any, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nuscenes.map_expansion import map_api

    def patch(polygon: Any, **style: Any) -> PathPatch:
        rings = (polygon.exterior, *polygon.interiors)
        return PathPatch(Outline.make_compound_path(*(Outline(np.array(ring.coords)) for ring in rings)), **style)

    # descartes, which the devkit draws polygons with, does not work with shapely 2, whatever the map.
    monkeypatch.setattr(map_api.descartes, "PolygonPatch", patch)
    road_map = map_api.NuScenesMap(str(root), "boston-seaport")
    poses, figure, _ = road_map.render_egoposes_on_fancy_map(nusc, verbose=False)
    pyplot.close(figure)
    assert len(poses) == len(nusc.sample)


def test_the_tutorial_of_the_can_bus(nusc: Any, root: Path, tmp_path: Path) -> None:
    from nuscenes.can_bus.can_bus_api import NuScenesCanBus

    can_bus = NuScenesCanBus(str(root))
    assert can_bus.list_misaligned_routes() == []
    for scene in nusc.scene:
        assert all(can_bus.get_messages(scene["name"], kind) for kind in can_bus.all_messages)
        pose = can_bus.get_messages(scene["name"], "pose")
        assert pose[0]["utime"] == nusc.get("sample", scene["first_sample_token"])["timestamp"]
        with redirect_stdout(io.StringIO()):
            can_bus.print_all_message_stats(scene["name"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        can_bus.plot_baseline_route(nusc.scene[0]["name"], out_path=str(tmp_path / "route.png"))
        can_bus.plot_message_data(nusc.scene[0]["name"], "steeranglefeedback", "value")
    pyplot.close("all")


def test_times_are_apart_and_of_one_piece(nusc: Any, root: Path, source: DataSet) -> None:
    data = open_data(root)
    times, recorded = read_scene_times(root, VERSION), read_scene_times(source.root, source.version)
    assert compute_shifts_us([(name, *span) for name, span in times.items()]) == {}
    made = json.loads((root / VERSION / "challenger.json").read_text())["scenes"]
    for entry in made.values():
        shifted = tuple(time + entry["shift_us"] for time in recorded[entry["source_scene"]])
        assert times[entry["name"]] == shifted
    for row in nusc.sample_data:
        sample, pose = nusc.get("sample", row["sample_token"]), nusc.get("ego_pose", row["ego_pose_token"])
        assert row["timestamp"] == sample["timestamp"] == pose["timestamp"]
        assert f"__{row['timestamp']}-" in row["filename"] and (root / row["filename"]).is_file()
    for name in data.scene_names("adv"):
        scene, own = data.scene(name), CanBus.read(root, name)
        assert own.motion is not None and own.motion.times_us[0] == scene.timestamps_us[0]
        assert all(observation.ego.source == "can_bus" for observation in data.observations(name))
    assert check_tables(root) == []


def test_scenes_are_known_by_recording_and_variant_and_found_by_number(root: Path) -> None:
    data, rows = open_data(root), read_names(root / VERSION)
    names = data.scene_names("adv")
    assert names == list_scenes(root, "adv") == tuple(sorted(rows.values()))
    assert all(re.fullmatch(r"scene-990\d-[0-9a-f]{8}", name) for name in names)
    assert [data.scene(name).name for name in names] == list(names)
    assert {facts.source for facts in data.scene_facts(names).values()} == {"scene-9901", "scene-9902"}
    first, second = sorted(rows)[:2]
    assert EvalSettings(scenes=(second, rows[first])).chosen(data, "adv") == (rows[first], rows[second])
    with pytest.raises(InputError, match="no scene scene-1999"):
        EvalSettings(scenes=("scene-1999",)).chosen(data, "adv")
    assert statistics(root, split="adv").counts.scenes == len(names)
    assert statistics(root, split="adv").labelled == statistics(root).labelled == len(names)


def test_official_code_evaluates_in_the_order_of_recorded_times(root: Path) -> None:
    data = open_data(root)
    names = data.scene_names("adv")
    assert sort_as_published(data, names) == tuple(sorted(names, key=lambda name: (data.scene(name).token, name)))


def test_a_frozen_split_brings_numbers_and_times_and_older_ones_bring_none(
    source: DataSet, root: Path, tmp_path: Path
) -> None:
    split = read_frozen_split(root.parent / "road-adv-1.json")
    rebuilt = replace(QUICK, out=tmp_path / "rebuilt")
    report = build_frozen(source, split, rebuilt)
    assert not report.other_tables and not report.other_images
    assert read_names(rebuilt.out / VERSION) == read_names(root / VERSION)
    assert read_scene_times(rebuilt.out, VERSION) == read_scene_times(root, VERSION)
    one = read_names(root / VERSION)["scene-2002"]
    assert [frozen.name for frozen, _ in split.chosen(("scene-2002",), None)] == [one]
    older = replace(
        split,
        frozen=split.frozen.model_copy(
            update={
                "scenes": tuple(
                    scene.model_copy(update={"numbered": None, "shift_us": None}) for scene in split.frozen.scenes
                )
            }
        ),
    )
    assert '"numbered"' not in older.frozen.text() and older.frozen.content_id != split.frozen.content_id
    build_frozen(source, older, replace(QUICK, out=tmp_path / "older"))
    assert not read_names(tmp_path / "older" / VERSION)
    first = {span[0] for span in read_scene_times(tmp_path / "older", VERSION).values()}
    assert len(first) == 1
    said = [fault.sentence for fault in check_tables(tmp_path / "older")]
    assert len(said) == 2 and "list_scenes()" in said[0] and "render_egoposes_on_fancy_map()" in said[1]
    assert {fault.severity for fault in check_tables(tmp_path / "older")} == {"warning"}


def test_other_numbers_rename_pictures_and_draw_none_again(source: DataSet, root: Path, tmp_path: Path) -> None:
    settings = replace(QUICK, out=tmp_path / "adv")
    build_split(source, "adv", replace(settings, per_scene=1))
    few, CountingRenderer.drawn = read_names(settings.out / VERSION), 0
    build_split(source, "adv", settings)
    frames = {name: len(open_data(root).scene(name).keyframes) for name in read_names(root / VERSION).values()}
    assert any(read_names(root / VERSION)[row] != name for row, name in few.items()), "a number has to change"
    assert CountingRenderer.drawn == sum(count for name, count in frames.items() if name not in few.values())
    assert contents(settings.out).keys() == contents(root).keys()
    assert {name: data for name, data in contents(settings.out).items() if "rounds" not in name} == contents(root)


def test_a_root_of_an_earlier_version_stays_what_it_is(
    source: DataSet, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = replace(QUICK, out=tmp_path / "adv")
    with monkeypatch.context() as earlier:
        earlier.setattr(selection, "number_jobs", lambda _, jobs, __: list(jobs))
        build_split(source, "adv", settings)
    before = contents(settings.out)
    assert not read_names(settings.out / VERSION)
    build_split(source, "adv", settings)
    assert contents(settings.out) == before


def test_numbers_do_not_depend_on_the_order_and_leave_out_names_of_recordings() -> None:
    times = {"scene-2001-b": (0, 20), "scene-2001-a": (0, 20), "scene-0001-c": (30_000_000, 40_000_000)}
    numbers = number_scenes(times, {"scene-2001"})
    assert numbers == number_scenes(dict(reversed(times.items())), {"scene-2001"})
    assert [numbers[name].name for name in sorted(times)] == ["scene-2002", "scene-2003", "scene-2004"]
    assert [numbers[name].shift_us for name in sorted(times)] == [0, 0, 10_000_020]
    assert number_scenes({f"scene-{number}": (0, 1) for number in range(8_000)}) == {}


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"name": "../elsewhere"}, "letters, digits"),
        ({"name": 3}, "letters, digits"),
        ({"shift_us": 1.5}, "whole microseconds"),
        ({"name": "twice"}, "two scenes have the name twice"),
    ],
)
def test_names_that_are_none_are_refused_and_found(
    root: Path, tmp_path: Path, change: dict[str, object], why: str
) -> None:
    folder = tmp_path / VERSION
    folder.mkdir()
    for path in (root / VERSION).iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    for name in ("maps", "samples", "sweeps", "can_bus"):
        (tmp_path / name).symlink_to(root / name)
    made = json.loads((folder / "challenger.json").read_text())
    for row in sorted(made["scenes"])[:2]:
        made["scenes"][row] |= change
    write_json(folder / "challenger.json", made)
    with pytest.raises(InputError, match=why):
        open_data(tmp_path)
    assert any(why in fault.sentence for fault in check_tables(tmp_path))
