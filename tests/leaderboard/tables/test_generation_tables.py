"""Statistics, manoeuvres, search, runtime and ablation: ours, and the paper's beside them."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmark.errors import InputError
from benchmark.machine.storage import write_json
from benchmark.metrics.rates import PairedDifference
from benchmark.records.ablation import find_ablations
from benchmark.records.scene_pages import NO_SCENE_PAGES, SPLIT_FILE, find_scene_pages, split_folder
from benchmark.report.cells import UNDEFINED
from benchmark.report.table import Table
from leaderboard.build import find_stale_files, write_leaderboard
from leaderboard.frame.results import read_results
from leaderboard.frame.specification import group_by_data_set
from leaderboard.tables.ablation import ablation_tables
from leaderboard.tables.contents import generation_tables
from leaderboard.tables.published import published_data_set_table, published_runtime_table, published_tables
from leaderboard.tables.runtime import runtime_tables
from leaderboard.tables.statistics import manoeuvre_tables, statistics_tables
from tests.leaderboard.csv_rows import csv_rows
from tests.leaderboard.made_up import (
    ATTEMPTS,
    NO_ADVERSARY,
    RUNTIME,
    STATISTICS,
    sheets_of,
    split_sheet,
    study,
    workspace_sheets,
)

PAPER = Path(__file__).parents[4] / "shared" / "paper" / "challenger.tex"


def named(tables: dict[str, tuple[Table, ...]], name: str, data: str = "d") -> Table:
    (found,) = [table for table in tables[data] if table.name == name]
    return found


def row_of(table: Table, first: str) -> dict[str, str]:
    (row,) = [row for row in table.rows if row[0] == first]
    return dict(zip(table.columns, row, strict=True))


def test_a_data_set_stands_beside_that_of_the_paper() -> None:
    table = named(group_by_data_set(workspace_sheets(), statistics_tables), "data-set")
    assert table.columns == ("rows of", "val", "adv", "Adv-nuSc (paper)")
    assert tuple(row_of(table, "instances").values()) == ("instances", "1,103", "1,103", "12,858")
    assert row_of(table, "scenes with 1 adversary")["adv"] == "3"
    assert tuple(row_of(table, "scenes with 2 adversaries").values())[1:] == ("0", "1", UNDEFINED)
    assert table.cells is not None
    ours, quoted = table.cells[0][1], table.cells[0][3]
    assert ours is not None and ours.record == "valfffffffff d on val" and ours.value == 1103
    assert quoted is not None and quoted.record is None and quoted.source == table.sources[0]


def test_recordings_have_no_adversaries_in_any_table() -> None:
    tables = generation_tables(sheets_of(split_sheet("val")), [])
    assert [table.name for table in tables["d"]] == ["data-set"]
    assert generation_tables(NO_SCENE_PAGES, []) == {}


def test_what_the_search_discarded_adds_up_and_how_close_adversaries_come() -> None:
    tables = group_by_data_set(workspace_sheets(), statistics_tables)
    assert [row[:4] for row in named(tables, "search-adv").rows] == [
        ("kept", "2", "40.0", "2"),
        ("touches-another", "2", "40.0", "2"),
        ("never-close", "1", "20.0", "1"),
        ("all", "5", "100.0", "2"),
    ]
    gap, time = named(tables, "closeness").rows
    assert gap == ("adv", "smallest gap between the bodies, m", "5", "0.10", "0.20", "0.50", "1.20", "1.70")
    assert time[:3] == ("adv", "time to collision, s", "4")


def test_manoeuvres_with_their_places_and_gaps() -> None:
    table = named(group_by_data_set(workspace_sheets(), manoeuvre_tables), "manoeuvres-adv")
    assert table.columns == ("manoeuvre", "primary", "%", "at any time", "straight", "junction", "median gap, m")
    assert table.rows[0] == ("cut-in-left", "4", "80.0", "4", "3", "1", "0.48")
    assert row_of(table, "following")["median gap, m"] == UNDEFINED and row_of(table, "all")["primary"] == "5"


def test_runtime_by_stage_and_the_papers_with_its_hardware() -> None:
    table = named(group_by_data_set(workspace_sheets(), runtime_tables), "runtime-adv")
    assert [row[0] for row in table.rows] == ["sampling", "physics", "scoring", "rendering", "other", "all"]
    physics = {"stage": "physics", "total, s": "30.00", "each, s": "6.00", "% of total": "42.9", "paper, s": "211.36"}
    assert row_of(table, "physics") == physics
    # Attempts and rendered scenes are counted apart: 62 s over 5 attempts and 8 s over 2 scenes.
    assert row_of(table, "rendering")["each, s"] == "4.00"
    assert row_of(table, "all")["each, s"] == f"{62 / 5 + 8 / 2:.2f}"
    assert row_of(table, "all")["paper, s"] == "818.62" and row_of(table, "other")["paper, s"] == UNDEFINED
    assert any("Xeon Platinum 8457C" in note and "L20" in note for note in table.notes)
    # Nothing timed is undefined and not zero.
    nothing = {"attempts": 0, "scenes": 0, "total_s": dict.fromkeys(RUNTIME["total_s"], 0.0)}
    table = named(group_by_data_set(sheets_of(split_sheet("adv", runtime=nothing)), runtime_tables), "runtime-adv")
    assert {(row[2], row[3]) for row in table.rows} == {(UNDEFINED, UNDEFINED)}


@pytest.mark.parametrize(
    ("statistics", "runtime", "where"),
    [
        ({}, None, "statistics.counts"),
        ({**STATISTICS, "gap_m": {"least": 1.0}}, None, "statistics.gap_m.tenth"),
        ({**STATISTICS, "counts": {"scenes": "many"}}, None, "statistics.counts"),
        (NO_ADVERSARY, {"attempts": 1}, "runtime.scenes"),
        (NO_ADVERSARY, {**RUNTIME, "total_s": {"physics": float("nan")}}, "runtime.total_s.physics"),
    ],
)
def test_a_damaged_sheet_is_a_sentence(
    statistics: dict[str, Any], runtime: dict[str, Any] | None, where: str, tmp_path: Path
) -> None:
    path = split_folder(tmp_path, "d", "adv") / SPLIT_FILE
    sound = split_sheet("adv").model_dump(mode="json", by_alias=True)
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({**sound, "statistics": statistics, "runtime": runtime}))
    with pytest.raises(InputError, match=rf"split\.json is damaged at {where}.*sheets again or delete"):
        find_scene_pages(tmp_path)


def test_numbers_of_a_split_are_stored_as_they_were(tmp_path: Path) -> None:
    """The form of ``split.json`` that all versions have written: nothing counted is an empty object."""
    for split, statistics, runtime in (("adv", STATISTICS, RUNTIME), ("val", NO_ADVERSARY, None)):
        stored = split_sheet(split, statistics=statistics, runtime=runtime).model_dump(mode="json", by_alias=True)
        assert stored["statistics"] == statistics and stored["runtime"] == runtime
        write_json(split_folder(tmp_path, "d", split) / SPLIT_FILE, stored)
    assert find_scene_pages(tmp_path).splits["d", "val"].statistics.gap_m is None


def test_the_ablation_with_its_intervals_and_the_papers_values() -> None:
    table = named(ablation_tables([study()]), "ablation-p")
    assert [row[0] for row in table.rows] == ["Challenger", "- MTR", "- TS", "- MTR - TS"]
    full, last = row_of(table, "Challenger"), row_of(table, "- MTR - TS")
    assert (full["tried"], full["kept"], full["discarded"], full["collisions"]) == ("4", "3", "1", "30/60")
    assert (full["of tried"], full["95 % of tried"], full["paper"]) == ("37.50", "[0.00, 50.00]", "6.17")
    assert (last["of kept"], last["95 % of kept"], last["mean gap, m"], last["paper"]) == (*(UNDEFINED,) * 3, "0.80")
    assert any(label == "collision rate in %, exact" for label, _ in table.groups)


def test_an_ablation_says_whom_its_collisions_are_with() -> None:
    older = study()
    less = PairedDifference(value=0.125, low=-0.0123, high=0.2, recordings=2, differing=1, enough=None)
    rows = (older.rows[0], older.rows[1].model_copy(update={"full_minus": less}))
    newer = older.model_copy(update={"schema_version": 2, "rows": rows})
    assert "touches anybody within 3 s" in older.table().plain(width=2000)
    assert "touches the adversary within 3 s" in newer.table().plain(width=2000)
    table = named(ablation_tables([newer]), "ablation-p")
    row = row_of(table, "- MTR")
    assert (row["full minus"], row["95 % full minus"]) == ("+12.50", "[-1.23, 20.00]")
    assert older.content_id != newer.content_id


def test_studies_of_one_planner_have_tables_of_their_own_a_copy_has_none_and_unknown_rows_no_published_value() -> None:
    (tables,) = ablation_tables([study(), study(seed=1), study("q"), study()]).values()
    names = [table.name for table in tables]
    assert len(set(names)) == 3 and names[2] == "ablation-q"
    assert all(name.startswith("ablation-p-") for name in names[:2])
    known = study()
    other = known.model_copy(update={"rows": (known.rows[0].model_copy(update={"name": "<b>mine</b>"}),)})
    table = named(ablation_tables([other]), "ablation-p")
    assert row_of(table, "<b>mine</b>")["paper"] == UNDEFINED
    assert "<b>" not in table.markdown() and "mine" in other.table().plain()


def test_a_record_that_quotes_the_paper_in_its_rows_is_the_same_study(tmp_path: Path) -> None:
    """Studies are found below a folder; a damaged one is named."""
    assert find_ablations(tmp_path / "nowhere") == []
    known = study()
    stored = known.model_dump(mode="json", by_alias=True)
    assert all("paper_rate" not in row for row in stored["rows"])
    for row, quoted in zip(stored["rows"], (0.0617, 0.0349, 0.0013, 0.0080), strict=True):
        row["paper_rate"] = quoted
    for later in ("published_as", "miniature"):
        del stored["planner"][later]
    write_json(tmp_path / "d" / "p" / "ablation.json", stored)
    path = tmp_path / "d" / "q" / "ablation.json"
    write_json(path, study("q").model_dump(mode="json", by_alias=True))
    read, other = find_ablations(tmp_path)
    assert read == known and read.content_id == known.content_id != study(seed=1).content_id
    assert other.planner.name == "q"
    path.write_text("{")
    with pytest.raises(InputError, match=r"q/ablation\.json.*delete or move"):
        find_ablations(tmp_path)


def test_the_leaderboard_has_them_in_every_form_without_runs(tmp_path: Path) -> None:
    sheets = workspace_sheets("../mine")
    written = write_leaderboard(read_results([], (), sheets, [study()]), tmp_path)
    files = {path.relative_to(tmp_path).as_posix() for path in written}
    assert {"tables/runtime.csv", "tables/ablation.csv", "published.csv", "tables.json", "tables.tex"} <= files
    text = (tmp_path / "README.md").read_text()
    assert "ablation of the search with p" in text and "manoeuvres of adversaries, and their places" in text
    assert csv_rows((tmp_path / "tables/ablation.csv").read_text())[0]["paper"] == "6.17"
    again = split_sheet("adv", data="../mine", statistics=STATISTICS, runtime={**RUNTIME, "attempts": 6})
    stale = find_stale_files(read_results([], (), sheets_of(again), [study()]), tmp_path)
    assert any("tables/runtime.csv" in sentence for sentence in stale)


@pytest.mark.skipif(not PAPER.is_file(), reason="the paper is not here")
def test_published_values_are_those_of_the_paper() -> None:
    lines = [line.replace("\\%", "") for line in PAPER.read_text().splitlines()]
    for row in published_data_set_table().rows:
        assert any(line.split() == ["\\#", *row[0].split(), "&", row[1], "\\\\"] for line in lines), row
    names = {"sampling": "Traj. Sampling", "scoring": "Traj. Scoring", "all": "Total"}
    for stage, seconds, _ in published_runtime_table().rows:
        printed = names.get(stage, stage.capitalize())
        assert any(line.strip().startswith(printed) and seconds in line for line in lines), stage
    by_name = {table.name: table for table in published_tables()}
    for label, rate in by_name["ablation-published"].rows:
        assert any(line.replace("\\quad", "").split("&")[0].split() == label.split() and rate in line for line in lines)


def test_what_is_not_labelled_is_not_counted() -> None:
    assert ATTEMPTS and group_by_data_set(sheets_of(split_sheet("adv", attempts=ATTEMPTS)), manoeuvre_tables) == {}
    hostile = {**STATISTICS, "manoeuvres": [{**STATISTICS["manoeuvres"][0], "manoeuvre": "a|b\n# c"}]}
    table = named(
        group_by_data_set(sheets_of(split_sheet("adv", statistics=hostile)), manoeuvre_tables), "manoeuvres-adv"
    )
    assert "\n# c" not in table.markdown() and "\n# c" not in table.latex()
