"""Rates at the kerb have a table of their own, and maxima share no column with means."""

import numpy as np
import pytest

from benchmark.protocols import MAXIMA, PROTOCOLS
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.collision import collision_table, run_tables
from leaderboard.tables.contents import build_data_set_tables
from leaderboard.tables.further_columns import further_table
from tests.benchmark.protocols.protocol_cases import Traits, plan_of, sample_of
from tests.benchmark.records.hand_made_records import CLEAN, HIT, LATE, hand_made

SCENES = {"s1": [HIT, CLEAN], "s2": [CLEAN, LATE]}


@pytest.mark.parametrize(
    ("protocol", "heads"),
    [
        ("bev-planner", ["kerb", "kerb before mask", "point on kerb"]),
        ("omnidrive", ["off road"]),
        ("opendrivevla", ["col. mean"]),
    ],
)
def test_a_protocol_with_further_columns_has_a_table_of_them(protocol: str, heads: list[str]) -> None:
    record = hand_made("p", SCENES, protocols=("exact", protocol))
    table = further_table(DataSetRuns("d", [record]), protocol)
    assert table is not None and table.columns[2::4][: len(heads)] == tuple(f"{head} 1s" for head in heads)
    assert protocol in table.title and len(table.rows) == 1
    names = [one.name for one in build_data_set_tables(DataSetRuns("d", [record])).others[protocol]]
    assert names[:2] == [f"collision-{protocol}", f"further-{protocol}"]
    assert [one.name for one in run_tables("d", [record], (protocol,))] == names[:2]


def test_means_and_values_at_a_step_have_columns_of_their_own_and_others_have_no_further_table() -> None:
    record = hand_made("p", {"s": [LATE]}, protocols=tuple(PROTOCOLS))
    columns = record.summary.protocols["opendrivevla"].columns
    assert columns["collision"]["3s"].value == 1.0 and columns["collision_mean"]["3s"].value == pytest.approx(1 / 6)
    found = {name for name in PROTOCOLS if further_table(DataSetRuns("d", [record]), name) is not None}
    assert found == {"bev-planner", "omnidrive", "opendrivevla"}


def test_maxima_are_those_whose_values_never_fall() -> None:
    kinds = [Traits(seed, 10, 9.0, 6, "drive", False) for seed in range(80)]
    truths, plans = [sample_of(kind) for kind in kinds], np.array([plan_of(kind) for kind in kinds])
    rising = set()
    for name, definition in PROTOCOLS.items():
        values = definition.sample_values(definition.evaluate(truths, plans))["collision"]
        assert values.any(), name
        rising |= {name} if (np.diff(values, axis=1) >= 0.0).all() else set()
    assert rising == {"exact", *MAXIMA}


def test_planners_whose_own_protocol_takes_maxima_are_not_among_means() -> None:
    protocols = ("exact", "vad", "bev-planner")
    of_vad = hand_made("a", SCENES, protocols=protocols, native="vad")
    of_maxima = hand_made("b", SCENES, protocols=protocols, native="bev-planner")
    table = collision_table(DataSetRuns("d", [of_vad, of_maxima]), "native")
    assert [row[0].text if hasattr(row[0], "text") else row[0] for row in table.rows] == ["a"]
    assert any("b on adv: bev-planner reports any contact" in note for note in table.notes)
