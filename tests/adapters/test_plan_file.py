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


def without(name: str) -> Callable[[Rows], Rows]:
    return lambda rows: [{key: value for key, value in row.items() if key != name} for row in rows]


def first(**values: Any) -> Callable[[Rows], Rows]:
    return lambda rows: [{**rows[0], **values}, *rows[1:]]


CHANGES: dict[str, tuple[Callable[[Rows], Rows], str]] = {
    "twice": (lambda rows: [*rows, rows[5]], "more than one row"),
    "no frame": (without("frame"), "no column frame"),
    "no key": (without("sample_token"), "no column scene"),
    "unknown column": (lambda rows: [{**row, "z1": 0.0} for row in rows], "unknown columns z1"),
    "no last waypoint": (without("y6"), "no column y6"),
    "nan": (first(x3=None), "not finite numbers for sample"),
    "infinite": (first(x3=1e999), "not finite numbers"),
    "truth": (first(x3=True), "true or false in column x3|not finite numbers"),
    "words": (first(x3="far"), "not finite numbers|has text .far. in numeric column x3"),
    "wrong frame": (first(frame="camera"), "unknown frame 'camera'"),
    "empty token": (first(sample_token=""), "without a sample_token"),
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
    contents = {"plans.txt": b"x", "empty.csv": b"", "latin.csv": b"sample_token,frame\n\xff\xfe,\x00\n"}
    contents |= {
        f"{k}.json": text for k, text in enumerate((b'{"a": 1}', b"[", b"3", b'[{"a": {"b": 1}}]', b"[[1, 2]]"))
    }
    says = {"none.csv": "no plan file", "plans.txt": r"neither \.csv", "empty.csv": "cannot be read"}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    for name in ("none.csv", *contents):
        with pytest.raises(InputError, match=says.get(name, ".")):
            read_plan_file(tmp_path / name)


def test_numbers_that_may_be_meant_otherwise_are_refused(tmp_path: Path) -> None:
    rows, by_time = rows_for(town_of_two()), rows_for(town_of_two(), by_time=True)
    rows[3]["x2"] = str(rows[3]["x2"])
    with pytest.raises(InputError, match=r"row 3 has text .* in numeric column x2"):
        read_plan_file(write(tmp_path / "digits.json", rows))
    by_time[0]["timestamp"] += 0.5
    with pytest.raises(InputError, match="not whole microseconds"):
        read_plan_file(write(tmp_path / "half.csv", by_time))
    # 1.234 beside 0,25 is a thousand and more, or one and a bit.
    pd.DataFrame([{**row, "x1": "1.234"} for row in rows_for(town_of_two())]).to_csv(tmp_path / "mixed.csv", **EXCEL)
    with pytest.raises(InputError, match="column x1 has numbers with points, and others have decimal commas"):
        read_plan_file(tmp_path / "mixed.csv")
    lidar = [{**row, "frame": "lidar"} for row in rows_for(town_of_two())]
    assert set(read_plan_file(write(tmp_path / "lidar.csv", lidar)).frames) == {PlanFrame.LIDAR}


def test_a_file_of_longer_plans(tmp_path: Path) -> None:
    data, far = town_of_two(), {f"{axis}{step}": 4.0 * step * (axis == "x") for step in range(7, 13) for axis in "xy"}
    rows = [{**row, **far} for row in rows_for(data)]
    record = evaluate(data, "val", plan_file_factory(write(tmp_path / "far.csv", rows), data, "val"), tmp_path / "out")
    assert all(row.plan is not None and len(row.plan.waypoints) == 12 for row in record.rows)
    for name, change, says in (
        ("gap.csv", without("y9"), "has no column y9"),
        ("far.csv", lambda rows: [{**row, "x17": 1.0} for row in rows], "unknown columns x17"),
    ):
        with pytest.raises(InputError, match=says):
            read_plan_file(write(tmp_path / name, change(rows)))
