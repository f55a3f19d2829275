import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scene_assessments import ASSESSMENTS_FILE, collect_assessments, collect_realism
from benchmark.errors import InputError
from benchmark.fairness.split_assessment import OWN_TOWN_REASON
from benchmark.machine.workers import LocalProcesses
from benchmark.machine.workspace import is_finished
from benchmark.protocols.exact import ExactProtocol
from benchmark.records.attempts import read_attempts
from benchmark.scene import Scene
from generation.pipeline.report import estimate_build
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.search.candidates import ExclusionReason
from tests.generation.labels.recorded_roads import QUICK, contents, recorded, write_source
from tests.hand_made import Car


def few_cars(name: str, ahead_m: float) -> Scene:
    return recorded(name, (Car(52.0 + ahead_m, 194.75, 9.0), Car(95.0, 198.25, 8.0), Car(45.0, 201.75, 8.0)))


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    root = tmp_path_factory.mktemp("recorded")
    return write_source(root, few_cars("scene-9901", 10.0), few_cars("scene-9902", 2.0))


def build(source: DataSet, out: Path, **changes: object) -> BuildSettings:
    settings = replace(QUICK, out=out, **changes)  # type: ignore[arg-type]
    build_split(source, "adv", settings)
    return settings


@pytest.fixture(scope="module")
def built(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(source, tmp_path_factory.mktemp("adv") / "out").out


@pytest.fixture
def out(built: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(built, tmp_path / "out"))


def test_the_new_data_set_opens_and_has_an_adversary_in_each_scene(source: DataSet, built: Path) -> None:
    data = open_data(built)
    names = data.scene_names("adv")
    report = json.loads((built / "report.json").read_text())
    rows = [json.loads(line) for line in (built / "attempts.jsonl").read_text().splitlines()]
    assert sorted(report["written"]) == sorted(names)
    assert report["survived"] == len(names) == sum(row["kept"] for row in rows)
    assert report["tried"] == len(rows) == report["survived"] + sum(report["discarded"].values())
    assert {row["written"] for row in rows} - {None} == set(names)
    for name in names:
        scene = data.scene(name)
        assert len(scene.adversaries) == 1
        assert name.startswith("scene-990")


def test_the_recorded_ego_never_collides_under_the_exact_protocol(built: Path) -> None:
    data = open_data(built)
    for name in data.scene_names("adv"):
        truths = data.truth(name)
        plans = np.stack([truth.ego_future[:, :2] for truth in truths])
        outcomes = ExactProtocol().evaluate(truths, plans)
        assert outcomes.counted.sum() >= 8
        assert not outcomes.collision[outcomes.counted].any()


@pytest.mark.parametrize("changes", [{"executor": LocalProcesses(2)}, {"together": 3}])
def test_neither_workers_nor_batches_change_a_byte(
    source: DataSet, built: Path, tmp_path: Path, changes: dict[str, object]
) -> None:
    build(source, tmp_path / "out", **changes)
    assert contents(tmp_path / "out") == contents(built)


def test_every_object_is_tried_or_has_a_reason(source: DataSet, built: Path) -> None:
    rows = [json.loads(line) for line in (built / "candidates.jsonl").read_text().splitlines()]
    assert [row["scene"] for row in rows] == ["scene-9901", "scene-9902"]
    for row in rows:
        assert row["tried"] + sum(row["not_tried"].values()) == row["objects"] == 3
        assert row["not_tried"].keys() <= set(ExclusionReason)
        assert sum(vehicle["not_tried"] is None for vehicle in row["vehicles"]) == row["tried"]


def test_the_summary_is_a_table_of_reasons(source: DataSet, built: Path) -> None:
    # Times lie beside the root and are not copied with it; another build there changes nothing.
    report = build_split(source, "adv", replace(QUICK, out=built))
    lines = report.summary().splitlines()
    assert lines[0] == f"2 scenes, {report.tried} vehicles tried, {len(report.written)} scenes written"
    counts = {tuple(line.split()[:-1]): line.split()[-1] for line in lines[2:]}
    assert len(counts) == len(lines) - 2
    for reason, count in report.discarded.items():
        assert ("discarded", str(count)) in {key for key, said in counts.items() if said == reason}
    assert report.runtime is not None
    assert report.runtime.attempts == report.tried
    assert report.runtime.scenes == len(report.written)


def test_a_half_finished_build_goes_on_to_the_same_bytes(source: DataSet, built: Path, out: Path) -> None:
    finished = sorted((out / ".challenger" / "attempts").iterdir())
    finished[0].unlink()
    (out / "report.json").unlink()
    left = finished[1].stat().st_mtime_ns
    build(source, out)
    assert contents(out) == contents(built)
    assert finished[1].stat().st_mtime_ns == left


def test_dry_run_counts_and_writes_nothing(source: DataSet, built: Path, tmp_path: Path) -> None:
    reports = {split: estimate_build(source, split, replace(QUICK, out=tmp_path / "out")) for split in ("adv", "val-r")}
    assert reports["adv"].tried > 0 == reports["adv"].finished_before
    for split, report in reports.items():
        text = report.summary()
        assert text.startswith(f"would build {split} from 2 scenes") and "tried" not in text
    assert not (tmp_path / "out").exists()
    before = contents(built)
    again = estimate_build(source, "adv", replace(QUICK, out=built))
    assert again.finished_before == again.tried
    assert contents(built) == before


def test_originals_are_written_for_val_r(source: DataSet, tmp_path: Path) -> None:
    report = build_split(source, "val-r", BuildSettings(out=tmp_path / "out", version="v1.0-mini"))
    assert report.written == ("scene-9901", "scene-9902")
    data = open_data(tmp_path / "out")
    assert data.scene("scene-9901").adversaries == ()
    assert report.runtime is not None
    assert (report.runtime.attempts, report.runtime.scenes) == (0, 2)


def test_ranking_limits_hold_and_best_comes_first(source: DataSet, out: Path) -> None:
    build(source, out, per_scene=1, total=1)
    rows = [json.loads(line) for line in (out / "attempts.jsonl").read_text().splitlines()]
    best = max((row for row in rows if row["kept"]), key=lambda row: row["challenge"])
    written = json.loads((out / "report.json").read_text())["written"]
    assert len(written) == 1
    assert written[0].startswith(best["scene"])


def test_a_build_that_finds_nothing_says_why_and_leaves_no_tables_of_an_earlier_one(
    source: DataSet, built: Path, out: Path
) -> None:
    with pytest.raises(NothingSurvivedError, match=r"never-gets-close|leaves|collision") as raised:
        build(source, out, hyper=replace(QUICK.hyper, close_gap_m=0.0))
    assert "\n" not in str(raised.value)
    assert raised.value.report.written == ()
    assert json.loads((out / "report.json").read_text())["written"] == []
    assert not is_finished(out)
    with pytest.raises(InputError):
        open_data(out)
    build(source, out)
    ours, theirs = contents(out), contents(built)
    assert {name for name in ours if not name.startswith(".challenger/")} == {
        name for name in theirs if not name.startswith(".challenger/")
    }
    assert all(ours[name] == data for name, data in theirs.items())


def test_reports_never_lie_beside_the_tables_of_another_build(
    source: DataSet, built: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*arguments: object, **options: object) -> list[str]:
        raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr("generation.pipeline.split.write_scenes", killed)
        with pytest.raises(KeyboardInterrupt):
            build(source, out, total=1)
    assert not is_finished(out)
    build(source, out)
    assert contents(out) == contents(built)


def test_a_change_of_layout_leaves_nothing_of_the_other_one(source: DataSet, built: Path, out: Path) -> None:
    build(source, out, layout="per-variant")
    assert not any(name.startswith("v1.0") for name in tables_and_sensor_files(out))
    names = open_data(out).scene_names("adv")
    assert len(names) == len(open_data(built).scene_names("adv")) and all(name.startswith("v") for name in names)
    build(source, out)
    assert open_data(out).scene_names("adv") == open_data(built).scene_names("adv")
    assert tables_and_sensor_files(out) == tables_and_sensor_files(built)


def tables_and_sensor_files(root: Path) -> dict[str, bytes]:
    """What a reader or a person finds, but for plain maps, which are the same in every layout."""
    return {name: data for name, data in contents(root).items() if not {"maps", ".challenger"} & set(Path(name).parts)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": ("scene-0000",)}, "scene-0000"),
        ({"limit": 0}, "limit"),
        ({"source_split": "test"}, "test"),
        ({"adversaries": 0}, "adversaries"),
    ],
)
def test_bad_settings_are_sentences(source: DataSet, tmp_path: Path, changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        build(source, tmp_path / "out", **changes)


@pytest.mark.parametrize("folder", ["attempts", "claims", "fragments", "maps"])
def test_spoilt_state_is_made_again(source: DataSet, out: Path, folder: str) -> None:
    spoilt = next((out / ".challenger" / folder).iterdir())
    whole = spoilt.read_bytes()
    for text in ("{", '{"kept": 3}', "null"):
        spoilt.write_text(text)
        build(source, out)
        assert spoilt.read_bytes() == whole


def test_without_a_map_there_is_nothing_to_drive_on(source: DataSet, tmp_path: Path) -> None:
    root = Path(shutil.copytree(source.root, tmp_path / "recorded"))
    for expansion in (root / "maps" / "expansion").glob("*.json"):
        expansion.unlink()
    with pytest.raises(InputError, match=r"no map expansion for scene-9901 \(2 of 2 scenes\)"):
        build(open_data(root), tmp_path / "out")


def test_what_is_said_of_each_scene_lies_beside_the_tables_and_in_no_fingerprint(built: Path, out: Path) -> None:
    data = open_data(built)
    names = data.scene_names("adv")
    stored = collect_assessments(data.root, data.version)
    assert set(stored) == set(names)
    rows = {row.written: row for row in read_attempts(built / "attempts.jsonl") if row.written is not None}
    assert {name: rows[name].judgements for name in names} == stored
    assert all(facts.judgement is not None for facts in data.scene_facts(names).values())
    realism = collect_realism(data.root, data.version)
    # The hand-made road says that it is our own town.
    assert realism is not None and realism.not_compared == OWN_TOWN_REASON and realism.adversaries == len(names)
    made = json.loads((built / data.version / "challenger.json").read_text())
    assert all("judgements" not in entry["report"] for entry in made["scenes"].values())
    (out / data.version / ASSESSMENTS_FILE).unlink()
    assert open_data(out).fingerprint() == data.fingerprint()


def test_it_is_said_how_many_scenes_nobody_could_have_avoided(
    source: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("generation.search.verify.is_unsolvable", lambda judgements: True)
    with pytest.raises(NothingSurvivedError) as nothing:
        build(source, tmp_path / "dropped", scenes=("scene-9901",))
    report = nothing.value.report
    assert report.unsolvable == {"dropped": report.discarded["unsolvable"], "written": 0}
    assert report.discarded["unsolvable"] > 0 and "dropped, 0 among those written" in report.summary()
    monkeypatch.setattr("generation.pipeline.report.is_unsolvable", lambda judgements: True)
    settings = replace(QUICK, out=tmp_path / "kept", hyper=replace(QUICK.hyper, solvable=False), scenes=("scene-9901",))
    kept = build_split(source, "adv", settings)
    assert kept.unsolvable == {"dropped": 0, "written": len(kept.written)} and kept.written
