"""Rows that are kept compressed are the rows, and their columns say what the rows say."""

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.metrics.consistency import measure_plan_distance, measure_plan_distances
from benchmark.protocols import ProtocolOutcomes
from benchmark.records import columns as columns_module
from benchmark.records.columns import RowColumns, build_batch
from benchmark.records.row_schema import OutcomeRow, SampleRow
from benchmark.records.rows import SampleRows, find_scene_failures, format_line, get_columns
from benchmark.records.run import RunRecord, load_record, write_record
from tests.benchmark.records.hand_made_records import CLEAN, HIT, facts_of, hand_made


def test_compressed_rows_are_the_rows(real: RunRecord) -> None:
    plain = list(real.rows)
    packed = SampleRows.of(plain)
    assert list(packed) == plain == [packed[at] for at in range(len(packed))]
    assert packed == tuple(plain) and packed[1:3] == plain[1:3] and packed[-1] == plain[-1]
    assert packed != plain[:-1] and packed != [*plain[1:], plain[0]]
    assert [SampleRow.model_validate(json.loads(line)) for line in packed.lines()] == plain
    for scene in real.run.scenes:
        assert packed.of_scene(scene) == [row for row in plain if row.scene == scene]
    assert packed.of_scene("no such scene") == []
    turned = packed.in_order_of(real.run.scenes[::-1])
    assert [row.scene for row in turned] == sorted((row.scene for row in plain), reverse=True)
    with pytest.raises(IndexError):
        packed[len(packed)]


def test_columns_say_what_rows_say(real: RunRecord) -> None:
    plain = list(real.rows)
    columns = RowColumns(plain)
    assert [plain[at].status for at in columns.planned] == ["ok"] * sum(row.status == "ok" for row in plain)
    for name in real.run.protocols:
        expected = ProtocolOutcomes.from_rows([vars(row.outcomes[name]) for row in plain if row.status == "ok"])
        assert columns.outcomes(name).as_rows() == expected.as_rows()
        judged = [row.outcomes.get(name) for row in plain]
        hits = [one is not None and one.counted and any(one.collision or ()) for one in judged]
        assert columns.collides(name).tolist() == hits
    for brief, row in zip(columns.brief, plain, strict=True):
        for name in ("scene", "sample_token", "index", "timestamp_us", "status", "command", "complete", "place"):
            assert getattr(brief, name) == getattr(row, name)
        assert (brief.severity, brief.diagnosis) == (row.severity, row.diagnosis)
        assert dict(brief.disagreements) == row.disagreements
    with pytest.raises(KeyError):
        columns.outcomes("none")


@pytest.mark.parametrize("at_once", [1, 7])
def test_columns_that_are_made_piece_by_piece_are_the_same(
    real: RunRecord, monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    plain = list(real.rows)
    expected = RowColumns(plain)
    monkeypatch.setattr(columns_module, "_ROWS_AT_ONCE", at_once)
    batch = build_batch(plain)
    assert batch is not None
    found = RowColumns([], batch)
    assert found.brief == expected.brief and np.array_equal(found.planned, expected.planned)
    for name in ("in_lidar", "recorded", "moved"):
        assert np.array_equal(getattr(found, name), getattr(expected, name), equal_nan=True)
    for name in real.run.protocols:
        assert found.outcomes(name).as_rows() == expected.outcomes(name).as_rows()
        assert (found.outcomes(name).known is None) == (expected.outcomes(name).known is None)


@pytest.mark.parametrize("at_once", [1, 7, 512])
def test_verdicts_that_do_not_go_together_are_those_of_rows(
    real: RunRecord, monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    monkeypatch.setattr(columns_module, "_ROWS_AT_ONCE", at_once)
    plain = [row for row in real.rows if row.status == "ok"]

    def changed(place: int, outcomes: dict[str, OutcomeRow]) -> RowColumns:
        own = plain[place].model_copy(update={"outcomes": outcomes})
        return RowColumns([*plain[:place], own, *plain[place + 1 :]])

    whole = plain[9].outcomes
    lacking = changed(9, {name: said for name, said in whole.items() if name != "exact"})
    with pytest.raises(KeyError):
        lacking.outcomes("exact")
    assert lacking.outcomes("uniad").as_rows() == RowColumns(plain).outcomes("uniad").as_rows()
    more = whole["exact"].model_copy(update={"steps": {**whole["exact"].steps, "more": [1] * 6}})
    assert changed(9, whole | {"exact": more}).outcomes("exact").steps.keys() == whole["exact"].steps.keys()
    assert changed(0, whole).outcomes("exact").steps.keys() == whole["exact"].steps.keys()
    with pytest.raises(KeyError):
        changed(0, whole | {"exact": more}).outcomes("exact")
    ragged = whole["exact"].model_copy(update={"steps": {name: [1.5] * 6 for name in whole["exact"].steps}})
    mixed = changed(9, whole | {"exact": ragged}).outcomes("exact")
    assert {values.dtype for values in mixed.steps.values()} == {np.dtype(np.float64)}


def test_plans_apart_are_those_one_by_one(real: RunRecord) -> None:
    columns, plain = real.columns, [row for row in real.rows if row.status == "ok"]
    pairs = [at for at, (one, other) in enumerate(pairwise(plain)) if one.scene == other.scene]
    pairs = [at for at in pairs if plain[at].recorded_future[0]]
    after = [at + 1 for at in pairs]
    found = measure_plan_distances(columns.in_lidar[pairs], columns.moved[pairs], columns.in_lidar[after])
    assert len(pairs) > 10
    assert np.array_equal(found, [measure_plan_distance(plain[at], plain[at + 1]) for at in pairs])


def test_a_record_is_written_and_read_as_the_same_bytes(real: RunRecord, tmp_path: Path) -> None:
    again = load_record(real.directory)
    assert again.rows == real.rows and again.summary == real.summary
    write_record(tmp_path, facts_of(again.run), list(again.rows), again.run.protocols, seed=again.run.seed)
    for name in ("samples.jsonl", "summary.json", "run.json"):
        assert (tmp_path / name).read_bytes() == (real.directory / name).read_bytes()
    assert (tmp_path / "samples.jsonl").read_text().splitlines() == [format_line(row) for row in real.rows]


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (lambda line: line[:-7], "line 1 is not valid JSON"),
        (lambda line: line.replace('"status":"ok"', '"status":"fine"'), "does not belong to the run.json"),
        (lambda line: line.replace('"index":0', '"index":NaN'), "does not belong to the run.json"),
    ],
)
def test_damaged_rows_are_said_as_before(
    real: RunRecord, tmp_path: Path, damage: Callable[[str], str], sentence: str
) -> None:
    for name in ("samples.jsonl", "summary.json", "run.json"):
        (tmp_path / name).write_bytes((real.directory / name).read_bytes())
    first, *others = (tmp_path / "samples.jsonl").read_text().splitlines()
    (tmp_path / "samples.jsonl").write_text("\n".join([damage(first), *others]) + "\n")
    with pytest.raises(InputError, match=sentence):
        load_record(tmp_path)


def test_verdicts_on_scenes_are_kept_and_nobody_can_change_them() -> None:
    made = hand_made("one", {"a": [CLEAN, HIT], "b": [CLEAN, CLEAN]})
    first = find_scene_failures(made.rows, "exact")
    first["a"] = None
    assert all(find_scene_failures(rows, "exact") == {"a": True, "b": False} for rows in (made.rows, list(made.rows)))
    assert get_columns(made.rows) is made.columns
    with pytest.raises(ValueError, match="read-only"):
        made.columns.outcomes("exact").collision[0, 0] = True
