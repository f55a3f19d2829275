"""Plan files: the same plan in three forms, and a sentence for everything that can be wrong with one."""

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from adapters.plan_file import WAYPOINT_COLUMNS, plan_file_factory, read_plan_file
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.planning import PlanFrame
from tests.benchmark.fake_data import FakeData, town_of_two


def rows_for(data: FakeData, *, by_time: bool = False) -> list[dict[str, Any]]:
    rows = []
    for scene in data.scene_names("val"):
        for truth in data.truth(scene):
            name = (
                {"scene": scene, "timestamp": truth.timestamp_us} if by_time else {"sample_token": truth.sample_token}
            )
            plan = np.column_stack([4.0 * np.arange(1, 7) + 0.1 * truth.index, np.full(6, 0.25)])
            rows.append({**name, "frame": "ego", **dict(zip(WAYPOINT_COLUMNS, plan.ravel().tolist()))})
    return rows


def write(path: Path, rows: list[dict[str, Any]]) -> Path:
    if path.suffix == ".json":
        path.write_text(json.dumps(rows))
    elif path.suffix == ".csv":
        pd.DataFrame(rows).to_csv(path, index=False)
    else:
        pd.DataFrame(rows).to_parquet(path)
    return path


@pytest.mark.parametrize("by_time", [False, True])
@pytest.mark.parametrize("ending", [".csv", ".json", ".parquet"])
def test_every_form_gives_the_plans_that_were_written(tmp_path: Path, ending: str, by_time: bool) -> None:
    data = town_of_two()
    path = write(tmp_path / f"mine{ending}", rows_for(data, by_time=by_time)[::-1])
    factory = plan_file_factory(path, data, "val")
    record = evaluate(data, "val", pickle.loads(pickle.dumps(factory)), tmp_path / "out")  # noqa: S301
    assert record.planner == "mine" and record.complete
    for row in record.rows:
        assert row.plan is not None and row.plan.frame == "ego"
        assert row.plan.waypoints[0] == [4.0 + 0.1 * row.index, 0.25]


def test_a_file_is_told_apart_by_its_content(tmp_path: Path) -> None:
    data, path = town_of_two(), tmp_path / "mine.csv"
    rows = rows_for(data)
    write(path, rows)
    one = plan_file_factory(path, data, "val")
    write(path, [{**row, "y6": 3.0} for row in rows])
    assert plan_file_factory(path, data, "val").facts != one.facts
    record = evaluate(data, "val", plan_file_factory(path, data, "val"), tmp_path / "out")
    assert all(row.plan is not None and row.plan.waypoints[5][1] == 3.0 for row in record.rows)


def test_part_of_a_split_needs_only_its_rows(tmp_path: Path) -> None:
    data = town_of_two()
    path = write(tmp_path / "mine.csv", rows_for(data)[:16])
    factory = plan_file_factory(path, data, "val", limit=1)
    assert evaluate(data, "val", factory, tmp_path, EvalSettings(limit=1)).complete
    with pytest.raises(InputError, match="no row for 16 samples"):
        plan_file_factory(path, data, "val")
    whole = write(tmp_path / "whole.csv", rows_for(data))
    plan_file_factory(whole, data, "val", scenes=("scene-9902",))


def test_missing_and_extra_rows_are_named(tmp_path: Path) -> None:
    data = town_of_two()
    rows = rows_for(data)
    with pytest.raises(InputError, match=f"no row for sample {rows[3]['sample_token']}"):
        plan_file_factory(write(tmp_path / "a.csv", rows[:3] + rows[4:]), data, "val")
    extra = [{**rows[0], "sample_token": f"{index:032x}"} for index in range(5)]
    with pytest.raises(InputError, match=r"rows for 5 samples 0{32}, .* and 2 more"):
        plan_file_factory(write(tmp_path / "b.csv", rows + extra), data, "val")


def test_missing_rows_are_failed_samples_where_that_is_allowed(tmp_path: Path) -> None:
    data = town_of_two()
    rows = rows_for(data)
    factory = plan_file_factory(write(tmp_path / "a.csv", rows[5:]), data, "val", allow_partial=True)
    record = evaluate(data, "val", factory, tmp_path / "out")
    assert record.run.status == "partial" and [row.status for row in record.rows] == ["failed"] * 5 + ["ok"] * 27
    assert all("has no row for sample" in str(row.error) for row in record.rows[:5])
    with pytest.raises(InputError, match=r"no row for 5 samples .* needs a plan, or give --allow-partial"):
        plan_file_factory(tmp_path / "a.csv", data, "val")
    with pytest.raises(InputError, match="no sample has one"):
        plan_file_factory(write(tmp_path / "b.csv", rows[:16]), data, "val", scenes=("scene-9902",), allow_partial=True)


def test_tokens_of_keyframe_rows_lead_to_their_samples(tmp_path: Path) -> None:
    data = town_of_two()
    rows = rows_for(data)
    row_of: dict[str, str] = {}
    for scene in data.scene_names():
        row_of |= {sample: row for row, sample in data.keyframe_rows(scene).items()}
    renamed = [{**row, "sample_token": row_of[row["sample_token"]]} for row in rows]
    for name, some in {"all": renamed, "half": rows[:16] + renamed[16:]}.items():
        factory = plan_file_factory(write(tmp_path / f"{name}.csv", some), data, "val")
        assert ["tokens of sample_data rows" in sentence for sentence in factory.sentences] == [True, False]
        record = evaluate(data, "val", pickle.loads(pickle.dumps(factory)), tmp_path / name)  # noqa: S301
        assert all(row.plan and row.plan.waypoints[0][0] == 4.0 + 0.1 * row.index for row in record.rows)
    plain = plan_file_factory(write(tmp_path / "plain.csv", rows), data, "val").sentences
    assert not any("sample_data" in sentence for sentence in plain)
    with pytest.raises(InputError, match="more than one row for sample"):
        plan_file_factory(write(tmp_path / "twice.csv", [*rows, renamed[0]]), data, "val")


def test_a_file_of_another_split_is_told_which(tmp_path: Path) -> None:
    data = replace(town_of_two(), train=("scene-9901",))
    mine = write(tmp_path / "mine.csv", rows_for(town_of_two())[:16])
    with pytest.raises(InputError, match="they are samples of its split 'train'; name that with --split"):
        plan_file_factory(mine, data, "val")
    assert plan_file_factory(mine, data, "train").facts.name == "mine"


EXCEL = {"sep": ";", "decimal": ",", "index": False, "encoding": "utf-8-sig", "lineterminator": "\r\n"}


@pytest.mark.parametrize("by_time", [False, True])
@pytest.mark.parametrize("form", [EXCEL, {**EXCEL, "decimal": "."}, {"index": False, "encoding": "utf-8-sig"}], ids=str)
def test_what_excel_writes_is_read(tmp_path: Path, form: dict[str, Any], by_time: bool) -> None:
    rows = rows_for(town_of_two(), by_time=by_time)
    pd.DataFrame(rows).to_csv(tmp_path / "excel.csv", **form)
    plain, excel = read_plan_file(write(tmp_path / "plain.csv", rows)), read_plan_file(tmp_path / "excel.csv")
    assert (plain.keys, plain.frames) == (excel.keys, excel.frames)
    assert np.array_equal(plain.waypoints, excel.waypoints)


def test_points_beside_decimal_commas_are_refused(tmp_path: Path) -> None:
    """1.234 beside 0,25 is a thousand and more, or one and a bit: who knows."""
    rows = [{**row, "x1": "1.234"} for row in rows_for(town_of_two())]
    pd.DataFrame(rows).to_csv(tmp_path / "mixed.csv", **EXCEL)
    with pytest.raises(InputError, match="column x1 has numbers with points, and others have decimal commas"):
        read_plan_file(tmp_path / "mixed.csv")


@pytest.mark.parametrize("by_time", [False, True])
def test_a_file_for_other_data_says_so_and_for_which(tmp_path: Path, by_time: bool) -> None:
    data = town_of_two()
    mine = write(tmp_path / "mine.csv", rows_for(data, by_time=by_time))
    named = {f"{name}-x": replace(scene, name=f"{name}-x") for name, scene in data.scenes.items()}
    other = FakeData(named, name="other")
    with pytest.raises(InputError, match=r"none of its 32 rows belongs to split 'val' of other; .* unknown here"):
        plan_file_factory(mine, other, "val", records=[tmp_path / "runs"])
    evaluate(data, "val", plan_file_factory(mine, data, "val"), tmp_path / "runs")
    with pytest.raises(InputError, match=f"they are samples of split 'val' of {data.name}, of which there are records"):
        plan_file_factory(mine, other, "val", records=[tmp_path / "runs"])


Rows = list[dict[str, Any]]
CHANGES: dict[str, tuple[Callable[[Rows], Rows], str]] = {
    "twice": (lambda rows: [*rows, rows[5]], "more than one row"),
    "no frame": (lambda rows: [{k: v for k, v in row.items() if k != "frame"} for row in rows], "no column frame"),
    "no key": (lambda rows: [{k: v for k, v in row.items() if k != "sample_token"} for row in rows], "no column scene"),
    "unknown column": (lambda rows: [{**row, "z1": 0.0} for row in rows], "unknown columns z1"),
    "no last waypoint": (lambda rows: [{k: v for k, v in row.items() if k != "y6"} for row in rows], "no column y6"),
    "nan": (lambda rows: [{**rows[0], "x3": None}, *rows[1:]], "not finite numbers for sample"),
    "infinite": (lambda rows: [{**rows[0], "x3": 1e999}, *rows[1:]], "not finite numbers"),
    "truth": (lambda rows: [{**rows[0], "x3": True}, *rows[1:]], "true or false in column x3|not finite numbers"),
    "words": (
        lambda rows: [{**rows[0], "x3": "far"}, *rows[1:]],
        "not finite numbers|has text .far. in numeric column x3",
    ),
    "wrong frame": (lambda rows: [{**rows[0], "frame": "camera"}, *rows[1:]], "unknown frame 'camera'"),
    "empty token": (lambda rows: [{**rows[0], "sample_token": ""}, *rows[1:]], "without a sample_token"),
    "no rows": (lambda rows: [], "no rows|no column|cannot be read"),
}


@pytest.mark.parametrize("ending", [".csv", ".json"])
@pytest.mark.parametrize("case", CHANGES)
def test_each_fault_is_one_sentence(tmp_path: Path, case: str, ending: str) -> None:
    change, says = CHANGES[case]
    path = write(tmp_path / f"plans{ending}", change(rows_for(town_of_two())))
    with pytest.raises(InputError, match=says):
        read_plan_file(path)


def test_files_that_are_no_tables(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no plan file"):
        read_plan_file(tmp_path / "none.csv")
    (tmp_path / "plans.txt").write_text("x")
    with pytest.raises(InputError, match=r"neither \.csv"):
        read_plan_file(tmp_path / "plans.txt")
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(InputError, match="cannot be read"):
        read_plan_file(tmp_path / "empty.csv")
    for text in ('{"a": 1}', "[", "3", '[{"a": {"b": 1}}]', "[[1, 2]]"):
        (tmp_path / "odd.json").write_text(text)
        with pytest.raises(InputError):
            read_plan_file(tmp_path / "odd.json")
    (tmp_path / "latin.csv").write_bytes(b"sample_token,frame\n\xff\xfe,\x00\n")
    with pytest.raises(InputError):
        read_plan_file(tmp_path / "latin.csv")


def test_text_of_digits_is_no_number(tmp_path: Path) -> None:
    rows = rows_for(town_of_two())
    rows[3]["x2"] = str(rows[3]["x2"])
    with pytest.raises(InputError, match=r"row 3 has text .* in numeric column x2"):
        read_plan_file(write(tmp_path / "plans.json", rows))


def test_times_are_whole_microseconds(tmp_path: Path) -> None:
    rows = rows_for(town_of_two(), by_time=True)
    rows[0]["timestamp"] += 0.5
    with pytest.raises(InputError, match="not whole microseconds"):
        read_plan_file(write(tmp_path / "plans.csv", rows))


def test_lidar_plans_stay_lidar_plans(tmp_path: Path) -> None:
    rows = [{**row, "frame": "lidar"} for row in rows_for(town_of_two())]
    assert set(read_plan_file(write(tmp_path / "plans.csv", rows)).frames) == {PlanFrame.LIDAR}


def test_a_file_of_longer_plans(tmp_path: Path) -> None:
    data = town_of_two()
    rows = rows_for(data)
    for one in rows:
        one.update({f"{axis}{step}": 4.0 * step if axis == "x" else 0.25 for step in range(7, 13) for axis in "xy"})
    record = evaluate(data, "val", plan_file_factory(write(tmp_path / "far.csv", rows), data, "val"), tmp_path / "out")
    assert all(row.plan is not None and len(row.plan.waypoints) == 12 for row in record.rows)
    del rows[0]["y9"]
    for one in rows[1:]:
        del one["y9"]
    with pytest.raises(InputError, match="has no column y9"):
        read_plan_file(write(tmp_path / "gap.csv", rows))
    for one in rows:
        one.update({"y9": 0.25, "x17": 1.0})
    with pytest.raises(InputError, match="unknown columns x17"):
        read_plan_file(write(tmp_path / "too-far.csv", rows))
