"""Every format that carries a plan, written from a record's plans and read back."""

import dataclasses
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from adapters.registry import planner_factory
from adapters.result_files.contract import FileFrame
from adapters.result_files.frames import ego_waypoints, lidar_waypoints, plans_of
from adapters.result_files.importing import ImportedPlans, import_results
from adapters.result_files.planner import result_file_factory
from adapters.result_files.recognition import FORMATS, recognise
from adapters.result_files.samples import RecordedSamples, read_recorded_samples, rotate
from adapters.result_files.synthetic import PRECISION_M, SINGLE_M, make_synthetic_plans, make_synthetic_samples
from adapters.result_files.writing.formats import WRITERS, write_results
from adapters.result_files.writing.pickles import PickledTensor, PlansToWrite
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.planning import Plan, PlanFrame
from benchmark.records.run import RunRecord, load_record
from benchmark.runs.rescoring import rescore
from benchmark.untrusted.files import RefusedFileError
from leaderboard.frame.runs import DataSetRuns
from leaderboard.site.index_data import build_model_index
from leaderboard.tables.collision import collision_table
from leaderboard.tables.transfer import transfer_matrices, transfer_table
from tests.benchmark.fake_data import FakeData, town_of_two

REAL_YAW = np.radians(-89.884)


def written(folder: Path, name: str, samples: RecordedSamples, plans: dict[int, Plan]) -> ImportedPlans:
    steps = min(len(plan.waypoints) for plan in plans.values())
    dumped = PlansToWrite(samples, tuple(dict.fromkeys(samples.scenes)), plans, steps)
    return import_results([recognise(WRITERS[name](folder / name, dumped))], samples)


@pytest.mark.parametrize("frame", list(PlanFrame))
@pytest.mark.parametrize("name", list(WRITERS))
def test_plans_come_back_through_the_real_calibration(name: str, frame: PlanFrame, tmp_path: Path) -> None:
    samples = make_synthetic_samples(REAL_YAW)
    plans = make_synthetic_plans(samples, frame)
    found, ahead_m = written(tmp_path, name, samples, plans), float(samples.lidar_in_ego[0, 0])
    for row, plan in plans.items():
        again = found.plans[samples.tokens[row]]
        away = np.abs(again.waypoints_in_lidar(ahead_m) - plan.waypoints_in_lidar(ahead_m))
        assert away.max() <= PRECISION_M.get(name, SINGLE_M)


@pytest.mark.parametrize("kind", [np.asarray, torch.from_numpy, np.ndarray.tolist], ids=["array", "tensor", "list"])
def test_batches_of_one_plan_are_read_with_and_without_a_heading(tmp_path: Path, kind: Callable[[Any], Any]) -> None:
    samples = make_synthetic_samples()
    written(tmp_path, "admlp", samples, make_synthetic_plans(samples))
    path = tmp_path / "admlp" / "output_data.pkl"
    with_heading = recognise(path)
    plans = {token: kind(np.asarray(plan)[:, :, :2]) for token, plan in with_heading.content.items()}
    path.write_bytes(pickle.dumps(plans, 4))
    without = recognise(path)
    assert without.format.name == with_heading.format.name == "admlp" and "sparseworld" in without.format.planners
    expected, found = (import_results([opened], samples).found for opened in (with_heading, without))
    assert np.array_equal(found.waypoints, expected.waypoints) and found.rows.tolist() == expected.rows.tolist()
    path.write_bytes(pickle.dumps({token: np.zeros((1, 6, 4)) for token in plans}, 4))
    with pytest.raises(RefusedFileError, match="1 x 6 x 3 or 1 x 6 x 2"):
        import_results([recognise(path)], samples)


def test_what_is_known_of_the_order(tmp_path: Path) -> None:
    samples = make_synthetic_samples()
    plans = make_synthetic_plans(samples)
    known = dict.fromkeys(("vad-out", "bev-planner", "bev-planner-json"), "proven") | {"sparsedrive": "consistent"}
    assert set(WRITERS) == set(FORMATS)
    for name in WRITERS:
        assert written(tmp_path, name, samples, plans).found.order == known.get(name, "tokens"), name


@pytest.mark.parametrize("name", ["sparsedrive", "vad-out"])
@pytest.mark.parametrize("mixed", [False, True], ids=["kept apart", "mixed"])
def test_variants_are_found_whether_info_files_keep_them_apart_or_mix_them(
    tmp_path: Path, name: str, mixed: bool
) -> None:
    recorded = make_synthetic_samples()
    ticks = [recorded.scenes[:row].count(scene) for row, scene in enumerate(recorded.scenes)]
    times = np.array(ticks, np.int64) * 500_000
    samples = dataclasses.replace(recorded, timestamps_us=times, by_time=np.argsort(times, kind="stable"))
    apart, official = samples.possible_orders()
    assert [samples.scenes[row] for row in apart.by_time] == sorted(samples.scenes)
    assert official.by_time.tolist() == samples.by_time.tolist() != apart.by_time.tolist()
    plans = make_synthetic_plans(samples)
    dumped = PlansToWrite(samples, tuple(dict.fromkeys(samples.scenes)), plans, 6)
    # A cached property: what a run on mixed info files would have dumped.
    vars(dumped)["info_rows"] = (official if mixed else apart).by_time
    found = import_results([recognise(WRITERS[name](tmp_path, dumped))], samples).found
    assert found.rows.tolist() == dumped.info_rows.tolist()
    assert found.order in ("proven", "consistent")


def test_one_command_alone_leaves_the_order_assumed(tmp_path: Path) -> None:
    samples = make_synthetic_samples()
    straight = tuple(scene for scene in ("scene-0003", "scene-0004"))
    plans = {row: plan for row, plan in make_synthetic_plans(samples).items() if samples.scenes[row] in straight}
    dumped = PlansToWrite(samples, straight, plans, 6)
    opened = [recognise(WRITERS["sparsedrive"](tmp_path, dumped))]
    found = import_results(opened, samples, straight).found
    assert found.order == "assumed" and len(found.rows) == len(plans)
    with pytest.raises(InputError, match="--scenes"):
        import_results(opened, samples)


def test_plans_of_six_seconds_keep_their_steps_and_judges_take_the_first_three(tmp_path: Path) -> None:
    samples = make_synthetic_samples()
    plans = {
        row: dataclasses.replace(plan, waypoints=np.concatenate([plan.waypoints, 1.5 * plan.waypoints]))
        for row, plan in make_synthetic_plans(samples).items()
    }
    found = written(tmp_path, "sparsedrive", samples, plans)
    assert found.found.waypoints.shape == (len(plans), 12, 2)
    assert lidar_waypoints(found.found, samples).shape[1] == 12 and ego_waypoints(found.found, samples).shape[1] == 6
    assert all(len(plan.waypoints) == 12 for plan in found.plans.values())


def test_the_sign_of_x_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    samples = make_synthetic_samples()
    plans = make_synthetic_plans(samples)
    assert written(tmp_path / "a", "uniad", samples, plans).found.mirrored is True
    monkeypatch.setattr("adapters.result_files.writing.pickles.MIRRORED", np.array([1.0, 1.0]))
    found = written(tmp_path / "b", "uniad", samples, plans)
    assert found.found.mirrored is False
    assert np.abs(found.plans[samples.tokens[0]].waypoints - plans[0].waypoints).max() < SINGLE_M


def test_a_lidar_beside_the_middle_of_the_car_gives_plans_of_the_rear_axle(tmp_path: Path) -> None:
    samples = make_synthetic_samples()
    aside = dataclasses.replace(samples, lidar_in_ego=samples.lidar_in_ego + [0.0, 0.4, 0.0])
    found = written(tmp_path, "pred-trajs", aside, make_synthetic_plans(aside))
    assert {plan.frame for plan in plans_of(found.found, aside)} == {PlanFrame.EGO}


def test_frames_go_there_and_back() -> None:
    samples = make_synthetic_samples(REAL_YAW)
    plans = make_synthetic_plans(samples)
    dumped = PlansToWrite(samples, (), plans, 6)
    lidar, away = dumped.waypoints(5, FileFrame.LIDAR), dumped.waypoints(5, FileFrame.DISPLACEMENT)
    assert np.allclose(rotate(lidar, REAL_YAW), away) and np.allclose(rotate(away, np.pi / 2), plans[5].waypoints)


@pytest.mark.parametrize("kind", ["<f4", "<f8", "<f2", "<i8", "<i4", "<i2", "|b1"])
def test_tensors_are_what_pytorch_reads_and_the_same_bytes_each_time(kind: str) -> None:
    values = np.arange(12).reshape(1, 6, 2).astype(kind)
    data = pickle.dumps(PickledTensor(values, kind), 2)
    assert data == pickle.dumps(PickledTensor(values.copy(), kind), 2)
    read = pickle.loads(data)  # noqa: S301 - written in the line above
    assert torch.equal(read, torch.from_numpy(values))


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_tensors_that_pytorch_wrote_are_read(tmp_path: Path, protocol: int) -> None:
    tokens = iter(make_synthetic_samples().tokens)
    kinds = (torch.float32, torch.float64, torch.float16, torch.bfloat16, torch.int64)
    plans = {next(tokens): torch.ones(2, 6, dtype=kind).T for kind in kinds}
    plans[next(tokens)] = torch.zeros(6, 2, dtype=torch.bool)
    path = tmp_path / "plans.pkl"
    path.write_bytes(pickle.dumps(plans, protocol))
    content: dict[str, Any] = recognise(path).content
    for token, plan in plans.items():
        assert np.array_equal(np.asarray(content[token], np.float64), plan.to(torch.float64).numpy()), plan.dtype


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> tuple[FakeData, RunRecord]:
    data = town_of_two(slow_leader=True)
    out = tmp_path_factory.mktemp("runs")
    return data, evaluate(data, "val", planner_factory("constant-velocity"), out)


@pytest.mark.parametrize("name", list(WRITERS))
def test_a_record_of_the_file_is_that_of_the_planner_but_for_what_the_format_lacks(
    town: tuple[FakeData, RunRecord], name: str, tmp_path: Path
) -> None:
    data, record = town
    path = write_results(record, read_recorded_samples(data, "val"), name, tmp_path)
    factory = result_file_factory([recognise(path)], data, "val", name="again", native="uniad")
    timings = tmp_path / "timings"
    planner = pickle.loads(pickle.dumps(factory))  # noqa: S301
    found = evaluate(data, "val", planner, tmp_path / "runs", EvalSettings(timings=timings))
    assert found.complete and found.run.plans_from is not None and found.run.plans_from.format == name
    assert {"forecasts of others", "speed of the planner"} <= set(found.run.plans_from.lacks)
    assert ("positions finer than 0.01 m" in found.run.plans_from.lacks) == (PRECISION_M.get(name, 0.0) > 0.001)
    assert not list(timings.rglob("*"))
    away_m = max(
        np.abs(np.array(a.plan.waypoints) - b.plan.waypoints).max()
        if a.plan and b.plan and a.plan.frame == b.plan.frame
        else 0.0
        for a, b in zip(record.rows, found.rows)
    )
    assert away_m <= PRECISION_M.get(name, SINGLE_M)
    for protocol in ("uniad", "exact"):
        one, other = (each.summary.protocols[protocol].columns for each in (record, found))
        assert one["l2"]["avg"].value == pytest.approx(other["l2"]["avg"].value, abs=0.02)
        if PRECISION_M.get(name, 0.0) < 0.001:
            assert one["collision"]["avg"].value == other["collision"]["avg"].value


def test_the_record_and_every_table_say_where_plans_come_from(town: tuple[FakeData, RunRecord], tmp_path: Path) -> None:
    data, record = town
    path = write_results(record, read_recorded_samples(data, "val"), "sparsedrive", tmp_path)
    factory = result_file_factory([recognise(path)], data, "val", name="SD")
    assert factory.facts.native_protocol == "sparsedrive"
    found = evaluate(data, "val", factory, tmp_path / "runs")
    says = "SD on val: plans from a file (sparsedrive), samples in an order that is assumed"
    assert any(note.startswith(says) for note in collision_table(DataSetRuns("fake", [record, found]), "exact").notes)
    for matrix in transfer_matrices([record, found], "val").values():
        assert any(note.startswith(says) for note in transfer_table("fake", matrix).notes)
    assert any("order assumed" in sentence for sentence in factory.sentences)
    facts = {entry["name"]: entry["runs"][0]["facts"] for entry in build_model_index([record, found])}
    told = {name: next((text for term, text, *_ in of if term == "plans"), None) for name, of in facts.items()}
    assert told["constant-velocity"] is None and str(told["SD"]).startswith(says)
    again = load_record(found.directory)
    assert again.run == found.run and rescore(found.directory, data).run.plans_from == found.run.plans_from


def test_what_a_file_lacks_of_samples_is_said_and_no_zero(town: tuple[FakeData, RunRecord], tmp_path: Path) -> None:
    data, record = town
    path = write_results(record, read_recorded_samples(data, "val"), "omnidrive", tmp_path)
    first, second, *_ = sorted(path.iterdir())
    first.unlink()
    second.write_text('[{"Q": "", "A": ["The car should slow down."]}]')
    factory = result_file_factory([recognise(path)], data, "val")
    assert factory.plans_from.plans == factory.plans_from.samples - 2
    assert factory.plans_from.skipped == {second.name: "no trajectory"}
    assert any("1 sample skipped" in sentence for sentence in factory.sentences)
    found = evaluate(data, "val", factory, tmp_path / "runs")
    failed = {row.sample_token: row.error or "" for row in found.rows if row.status == "failed"}
    assert set(failed) == {first.name, second.name} and not found.complete
    assert "no plan for this sample: no trajectory" in failed[second.name]


def test_several_files_of_one_run(town: tuple[FakeData, RunRecord], tmp_path: Path) -> None:
    data, record = town
    samples = read_recorded_samples(data, "val")
    parts = []
    for number, scene in enumerate(("scene-9901", "scene-9902", "scene-9902")):
        rows = tuple(row for row in record.rows if row.scene == scene)
        part = dataclasses.replace(record, rows=rows)
        parts.append(recognise(write_results(part, samples, "pred-trajs", tmp_path / str(number))))
    found = import_results(parts, samples).found
    assert len(found.rows) == len(samples.tokens) and found.duplicates == len(samples.tokens) // 2
    facts = result_file_factory(parts[:2], data, "val").facts
    assert facts != result_file_factory(parts[:1], data, "val").facts


def test_a_file_that_names_no_samples_needs_a_plan_for_each(town: tuple[FakeData, RunRecord], tmp_path: Path) -> None:
    data, record = town
    rows = tuple(
        row if row.index else row.model_copy(update={"status": "failed", "plan": None, "outcomes": {}})
        for row in record.rows
    )
    for name in ("sparsedrive", "vad-out"):
        with pytest.raises(InputError, match="names no samples, so each needs a plan, but 2 have none"):
            write_results(dataclasses.replace(record, rows=rows), read_recorded_samples(data, "val"), name, tmp_path)


def test_part_of_a_split(town: tuple[FakeData, RunRecord], tmp_path: Path) -> None:
    data, _ = town
    record = evaluate(data, "val", planner_factory("constant-velocity"), tmp_path, EvalSettings(scenes=("scene-9902",)))
    for name in WRITERS:
        path = write_results(record, read_recorded_samples(data, "val"), name, tmp_path / name)
        factory = result_file_factory([recognise(path)], data, "val", scenes=("scene-9902",))
        assert factory.plans_from.plans == len(record.rows)
