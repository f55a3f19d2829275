"""No truth, no rate: what records say of scenes without labels, and of categories that are not nuScenes'."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark import api
from benchmark.datasets.categories import read_categories
from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.metrics.attacks import collect_scene_attacks
from benchmark.metrics.frames import samples_frame
from benchmark.metrics.scores import score_record
from benchmark.metrics.slices import compute_rates_by
from benchmark.metrics.transfer import transfer
from benchmark.protocols import PROTOCOLS
from benchmark.records.drives import load_drives
from benchmark.records.rows import find_scene_failures
from benchmark.records.run import RunRecord, load_record
from benchmark.runs.driving import drive_split
from benchmark.runs.rescoring import rescore, rescore_all
from benchmark.runs.rescoring_drives import rescore_drives
from generation.pipeline.report import estimate_build
from generation.pipeline.settings import BuildSettings
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.collision import collision_table
from tests.benchmark.edited_roots import (
    Row,
    annotated_until,
    copy_of,
    edit,
    rename_categories,
    small_town,
    without_annotations,
)
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import Straight
from tests.hand_made import Car, scene_on_straight_road

SCENES = ("scene-8000", "scene-8001", "scene-8002")
Root = Callable[[Callable[[Path], None]], Path]


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("town") / "town", len(SCENES))


@pytest.fixture(scope="module")
def whole(town: Path, tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return evaluate(open_data(town), "val", Straight(), tmp_path_factory.mktemp("whole"))


@pytest.fixture
def edited(town: Path, tmp_path: Path) -> Root:
    def made(change: Callable[[Path], None]) -> Path:
        root = copy_of(town, tmp_path / "town")
        change(root)
        return root

    return made


@pytest.fixture(scope="module")
def partly(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The town without the annotations of its second scene."""
    root = copy_of(town, tmp_path_factory.mktemp("partly") / "town")
    without_annotations(root, {SCENES[1]})
    return root


@pytest.fixture(scope="module")
def two_of_three(partly: Path, tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return evaluate(open_data(partly), "val", Straight(), tmp_path_factory.mktemp("two"))


def sentences(record: RunRecord, kind: str) -> list[str]:
    return [caveat.sentence for caveat in record.run.caveats if caveat.kind == kind]


def test_scenes_without_annotations_are_in_no_collision_rate_and_keep_their_l2(
    two_of_three: RunRecord, whole: RunRecord, town: Path, tmp_path: Path
) -> None:
    labelled = EvalSettings(scenes=(SCENES[0], SCENES[2]))
    expected = evaluate(open_data(town), "val", Straight(), tmp_path / "two", labelled).summary.protocols
    for name, summary in two_of_three.summary.protocols.items():
        for column, by_horizon in summary.columns.items():
            of = whole.summary.protocols if column in ("l2", "ade") else expected
            assert by_horizon == of[name].columns[column], (name, column)
        assert (summary.scenes_failed, summary.scenes_decided) == (expected[name].scenes_failed, 2)
        assert summary.counted == expected[name].counted
    assert {row.scene for row in two_of_three.rows if row.driving is not None} == {SCENES[0], SCENES[2]}
    assert sentences(two_of_three, "truth") == [
        "1 of 3 scenes (scene-8001) has no annotations: collision rates and counts of failed scenes exclude them"
    ]
    truth = {name: facts.truth for name, facts in two_of_three.run.scene_facts.items()}
    assert [each.annotations > 0 for each in truth.values() if each is not None] == [True, False, True]
    assert "straight ¶" in {row[0] for row in collision_table(DataSetRuns("t", [two_of_three]), "exact").rows}


def test_unknown_is_never_read_as_no_contact(two_of_three: RunRecord) -> None:
    again = load_record(two_of_three.directory)
    for record in (two_of_three, again):
        rows = record.rows_of(SCENES[1])
        assert rows and all(row.outcomes[name].collision is None for row in rows for name in row.outcomes)
        assert all(row.severity is None and row.driving is None and row.diagnosis is None for row in rows)
        assert find_scene_failures(record.rows, "exact")[SCENES[1]] is None
        assert collect_scene_attacks(record)[SCENES[1]].samples == ()
        own = score_record(record)
        assert not own.counted[[scene == SCENES[1] for scene in own.scenes]].any()
        frame = samples_frame(record)
        there = frame[(frame["scene"] == SCENES[1])]
        assert there["exact collision 3s"].isna().all() and there["exact l2 1s"].notna().any()
        assert transfer([record]).undecided == ((SCENES[1],),)
        counted = sum(part.samples for part in compute_rates_by(record, "command", "exact"))
        assert counted == record.summary.protocols["exact"].counted
    lines = (two_of_three.directory / "samples.jsonl").read_text().splitlines()
    stored = [row["outcomes"]["uniad"]["collision"] for row in map(json.loads, lines) if row["scene"] == SCENES[1]]
    assert set(map(repr, stored)) == {"None"}


def test_samples_that_look_beyond_the_labels_are_unknown(edited: Root, tmp_path: Path, whole: RunRecord) -> None:
    root = edited(lambda root: annotated_until(root, SCENES[0], 20))
    record = evaluate(open_data(root), "val", Straight(), tmp_path / "out", EvalSettings(("exact",)))
    known = [row.outcomes["exact"].collision is not None for row in record.rows_of(SCENES[0])]
    # Number 13 sees number 19, the last that is labelled, at 3 s.
    assert known == [True] * 14 + [False] * 26
    before = [row.outcomes["exact"] for row in whole.rows_of(SCENES[0])[:14]]
    assert [row.outcomes["exact"] for row in record.rows_of(SCENES[0])[:14]] == before
    assert sentences(record, "truth") == [
        "1 of 3 scenes (scene-8000) has incomplete annotations: 26 of 40 samples there are excluded from "
        "collision rates"
    ]


def test_rescoring_brings_truth_to_an_older_record_and_what_tables_say_until_then(
    two_of_three: RunRecord, partly: Path, tmp_path: Path
) -> None:
    directory = Path(shutil.copytree(two_of_three.directory, tmp_path / "older"))
    path = directory / "run.json"
    older = json.loads(path.read_text())
    for facts in older["scene_facts"].values():
        facts["truth"] = None
    path.write_text(json.dumps({**older, "caveats": []}))
    before = load_record(directory)
    assert any("older records" in note for note in collision_table(DataSetRuns("t", [before]), "exact").notes)
    after = rescore(directory, open_data(partly), protocols=tuple(two_of_three.run.protocols))
    assert after.run.scene_facts == two_of_three.run.scene_facts and after.run.caveats == two_of_three.run.caveats
    assert not any("older records" in note for note in collision_table(DataSetRuns("t", [after]), "exact").notes)


def test_transfer_refuses_where_no_scene_has_a_verdict(two_of_three: RunRecord) -> None:
    nothing = replace(two_of_three, rows=two_of_three.rows_of(SCENES[1]))
    with pytest.raises(InputError, match="no scene of split 'val' has a verdict of exact"):
        transfer([nothing])


def test_boxes_without_a_size_are_ignored_and_counted(edited: Root, tmp_path: Path) -> None:
    root = edited(lambda root: edit(root, "sample_annotation", lambda rows: rows[0]["size"].__setitem__(1, 0.0)))
    record = evaluate(open_data(root), "val", Straight(), tmp_path / "out", EvalSettings(("exact",)))
    (sentence,) = sentences(record, "boxes")
    assert sentence.startswith("1 annotation of scene-") and "they are ignored" in sentence


def test_foreign_categories_silence_those_that_go_by_them_and_a_map_gives_them_their_numbers_back(
    edited: Root, tmp_path: Path, whole: RunRecord
) -> None:
    root = edited(lambda root: rename_categories(root, lambda name: name.replace(".", "_")))
    record = evaluate(open_data(root), "val", Straight(), tmp_path / "out")
    for name, summary in record.summary.protocols.items():
        silent = PROTOCOLS[name].uses_categories
        assert (summary.columns["collision"]["avg"].value is None) == silent, name
        assert summary.columns["l2"] == whole.summary.protocols[name].columns["l2"]
        assert summary.mask_removed_steps is None or not silent
    assert (
        record.summary.driving is None and "unknown categories ('vehicle_car', " in sentences(record, "categories")[0]
    )
    meant = open_data(root, categories=read_categories("short"))
    mapped = evaluate(meant, "val", Straight(), tmp_path / "mapped")
    assert mapped.summary == whole.summary and mapped.run.caveats == []
    assert mapped.run.config["categories"]["vehicle_car"] == "vehicle.car"


def test_rescoring_takes_the_map_of_the_record(edited: Root, tmp_path: Path, whole: RunRecord) -> None:
    root = edited(lambda root: rename_categories(root, str.upper))
    meant = open_data(root, categories=read_categories("short"))
    judges = ("exact", "uniad")
    mapped = evaluate(meant, "val", Straight(), tmp_path / "mapped", EvalSettings(judges, limit=1))
    (result,) = rescore_all(tmp_path / "mapped", lambda _: open_data(root), meant.name, judges)
    assert result.sentence == "current"
    (result,) = rescore_all(tmp_path / "mapped", lambda _: open_data(root), meant.name)
    assert result.sentence == "rescored"
    again = load_record(mapped.directory)
    assert [row.outcomes["uniad"] for row in again.rows] == [row.outcomes["uniad"] for row in whole.rows_of(SCENES[0])]
    with pytest.raises(InputError, match="fingerprints differ"):
        rescore(mapped.directory, open_data(root))


def test_a_scene_without_a_complete_sample_has_no_rate_and_is_named(tmp_path: Path) -> None:
    short = FakeData({"scene-9901": scene_on_straight_road((Car(80.0, 198.25),), seconds=1.0)})
    record = evaluate(short, "val", Straight(), tmp_path)
    assert record.summary.protocols["exact"].columns["collision"]["avg"].value is None
    assert sentences(record, "truth") == [
        "1 of 1 scene (scene-9901) has no sample with 3 s of recorded future: only protocols that count incomplete "
        "samples have a rate there"
    ]


def test_an_ego_pose_that_never_moves_is_named(edited: Root, tmp_path: Path) -> None:
    def still(rows: list[Row]) -> None:
        for row in rows:
            row.update(translation=rows[0]["translation"], rotation=rows[0]["rotation"])

    root = edited(lambda root: edit(root, "ego_pose", still))
    record = evaluate(open_data(root), "val", Straight(), tmp_path / "out", EvalSettings(("exact",)))
    (sentence,) = sentences(record, "pose")
    assert sentence.startswith(
        "3 of 3 scenes (scene-8000, scene-8001, scene-8002) have the same ego pose at every sample"
    )


def test_an_empty_map_is_a_dash_under_scores_that_need_one(edited: Root, tmp_path: Path) -> None:
    def emptied(root: Path) -> None:
        for path in (root / "maps" / "expansion").glob("*.json"):
            layers = json.loads(path.read_text())
            kept = {"canvas_edge", "version"}
            empty = {name: value if name in kept else type(value)() for name, value in layers.items()}
            path.write_text(json.dumps(empty))

    judges = EvalSettings(("exact", "bev-planner", "omnidrive"), limit=1)
    record = evaluate(open_data(edited(emptied)), "val", Straight(), tmp_path / "out", judges)
    assert record.summary.driving is None
    of = record.summary.protocols
    for name, column in (("bev-planner", "kerb"), ("bev-planner", "kerb_point"), ("omnidrive", "off_road")):
        assert {rate.value for rate in of[name].columns[column].values()} == {None}
    assert of["exact"].columns["collision"]["avg"].value is not None


def test_drives_of_scenes_that_are_not_labelled_throughout_say_nothing_of_contacts(
    edited: Root, town: Path, tmp_path: Path
) -> None:
    def change(root: Path) -> None:
        without_annotations(root, {SCENES[1]})
        annotated_until(root, SCENES[0], 20)

    settings = api.drive_settings("val")
    record = drive_split(open_data(edited(change)), "val", Straight(), tmp_path / "out", settings)
    assert {row.scene for row in record.rows if row.unlabelled} == {SCENES[0], SCENES[1]}
    assert record.summary.columns["contact"].denominator == 1
    assert record.summary.columns["route"].denominator == 3 and record.summary.columns["nuplan_score"].denominator == 1
    assert [caveat.kind for caveat in record.facts.caveats] == ["truth", "truth"]
    assert load_drives(record.directory) == record
    assert rescore_drives(record.directory, open_data(tmp_path / "town")) == record
    sound = drive_split(open_data(town), "val", Straight(), tmp_path / "sound", replace(settings, limit=1))
    assert sound.facts.caveats == [] and "unlabelled" not in (sound.directory / "drives.jsonl").read_text()


def test_generation_skips_scenes_without_annotations_and_names_them(partly: Path, tmp_path: Path) -> None:
    data = open_data(partly)
    settings = BuildSettings(out=tmp_path / "out", renderer=None)
    report = estimate_build(data, "adv", settings)
    assert report.scenes == 2 and report.unlabelled == (SCENES[1],)
    assert report.summary().endswith("skipped 1 scene without annotations (scene-8001)")
    with pytest.raises(InputError, match="it has no annotation"):
        estimate_build(data, "adv", replace(settings, scenes=(SCENES[1],)))
