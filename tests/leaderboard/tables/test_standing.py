"""Published values with their sources; ours beside only where planner, protocol and split are the same."""

import dataclasses
import re
from pathlib import Path

import pytest

from benchmark.published import NEURONCAP, PUBLISHED_RESULTS, SAMPLES_OF, TABLE_1
from benchmark.records.run import RunRecord
from benchmark.report.cells import UNDEFINED
from leaderboard.tables.published import find_same_run, published_comparison_tables
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made

SHARED = Path(__file__).resolve().parents[4] / "shared"


def run(planner: str, *, split: str = "val", protocol: str = "uniad", samples: int | None = None) -> RunRecord:
    """A run that says that it is of all samples of nuScenes."""
    record = hand_made(
        planner, {"s0": [HIT, CLEAN], "s1": [CLEAN]}, split=split, protocols=(protocol,), native=protocol
    )
    count = SAMPLES_OF[split] if samples is None else samples
    return dataclasses.replace(record, summary=record.summary.model_copy(update={"samples": count}))


def ours_of(records: list[RunRecord]) -> dict[tuple[str, ...], tuple[str, ...]]:
    table = published_comparison_tables(records)[0]
    return {row[:4]: row[9:] for row in table.rows if any(text != UNDEFINED for text in row[9:])}


def test_every_value_has_a_source_and_columns() -> None:
    open_loop, closed_loop = published_comparison_tables()
    assert len(open_loop.rows) == len(PUBLISHED_RESULTS) > 30 and len(closed_loop.rows) == len(NEURONCAP)
    assert not any(column.startswith("ours") for column in open_loop.columns)
    for value in PUBLISHED_RESULTS:
        assert value.source and any(value.values) and (value.protocol or value.by)
    assert sum(value.source == TABLE_1[0].data_set for value in PUBLISHED_RESULTS) == 0
    assert {value.values for value in PUBLISHED_RESULTS} >= {row.percent for row in TABLE_1}


def test_ours_stands_beside_the_same_planner_protocol_and_split() -> None:
    beside = ours_of([run("uniad")])
    assert {key[0] for key in beside} == {"UniAD", "UniAD, table of checkpoints"}
    assert {key[2] for key in beside} == {"uniad"} and {key[1] for key in beside} == {"nuScenes-val"}
    assert {key[3] for key in beside} == {"collision (%)", "L2 (m)"}


def test_anything_else_stands_beside_nothing() -> None:
    """Other samples, another protocol, a variant, another planner or split; a part, a miniature, an earlier version."""
    whole = run("uniad")
    small = whole.run.planner.model_copy(update={"miniature": True})
    changes: tuple[dict[str, object], ...] = (
        {"scenes_in_split": 150}, {"status": "partial"}, {"planner": small}, {"protocols": {"uniad": 0}}
    )  # fmt: skip
    changed = [dataclasses.replace(whole, run=whole.run.model_copy(update=facts)) for facts in changes]
    others = run("uniad-mini"), run("mine"), run("uniad", protocol="vad"), run("uniad", split="adv", samples=6019)
    for record in (run("uniad", samples=400), *others, *changed):
        assert all(find_same_run(value, [record]) is None for value in PUBLISHED_RESULTS)
        assert not ours_of([record])


@pytest.mark.skipif(not (SHARED / "spec").is_dir(), reason="the specifications are not here")
def test_every_number_stands_in_a_specification_or_in_the_paper() -> None:
    text = " ".join(path.read_text() for folder in ("spec", "paper") for path in sorted((SHARED / folder).iterdir()))
    numbers = set(re.findall(r"\d+\.\d+", text))
    quoted = (*(each.values for each in PUBLISHED_RESULTS), *((*each.scores, each.collision) for each in NEURONCAP))
    for values in quoted:
        assert {number for number in values if number} <= numbers, values
