"""Statistics, manoeuvres, search, runtime and ablation: ours, and the paper's beside them."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmark.errors import InputError
from benchmark.machine.storage import write_json
from benchmark.records.ablation import AblationReport, find_ablations
from benchmark.records.scene_pages import NO_SCENE_PAGES, SPLIT_FILE, find_scene_pages, split_folder
from benchmark.report.cells import UNDEFINED
from benchmark.report.table import Table
from leaderboard.build import build_leaderboard_files, find_stale_files, write_leaderboard
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
    assert row_of(table, "instances") == {
        "rows of": "instances",
        "val": "1,103",
        "adv": "1,103",
        "Adv-nuSc (paper)": "12,858",
    }
    assert row_of(table, "scenes with 1 adversary")["adv"] == "3"
    assert row_of(table, "scenes with 2 adversaries") == {
        "rows of": "scenes with 2 adversaries",
        "val": "0",
        "adv": "1",
        "Adv-nuSc (paper)": UNDEFINED,
    }
    assert table.cells is not None
    ours, quoted = table.cells[0][1], table.cells[0][3]
    assert ours is not None and ours.record == "valfffffffff d on val" and ours.value == 1103
    assert quoted is not None and quoted.record is None and quoted.source == table.sources[0]


def test_recordings_have_no_adversaries_in_any_table() -> None:
    tables = generation_tables(sheets_of(split_sheet("val")), [])
    assert [table.name for table in tables["d"]] == ["data-set"]
    assert generation_tables(NO_SCENE_PAGES, []) == {}


def test_how_close_adversaries_come_and_over_how_many() -> None:
    table = named(group_by_data_set(workspace_sheets(), statistics_tables), "closeness")
    assert [row[:3] for row in table.rows] == [
        ("adv", "smallest gap between the bodies, m", "5"),
        ("adv", "time to collision, s", "4"),
    ]
    assert table.rows[0][3:] == ("0.10", "0.20", "0.50", "1.20", "1.70")


def test_what_the_search_discarded_adds_up() -> None:
    table = named(group_by_data_set(workspace_sheets(), statistics_tables), "search-adv")
    assert [row[:3] for row in table.rows] == [
        ("kept", "2", "40.0"),
        ("touches-another", "2", "40.0"),
        ("never-close", "1", "20.0"),
        ("all", "5", "100.0"),
    ]
    assert [row[3] for row in table.rows] == ["2", "2", "1", "2"]


def test_manoeuvres_with_their_places_and_gaps() -> None:
    table = named(group_by_data_set(workspace_sheets(), manoeuvre_tables), "manoeuvres-adv")
    assert table.columns[4:6] == ("straight", "junction")
    assert row_of(table, "cut-in-left") == {
        **{"manoeuvre": "cut-in-left", "primary": "4", "%": "80.0", "at any time": "4"},
        **{"straight": "3", "junction": "1", "median gap, m": "0.48"},
    }
    assert row_of(table, "following")["median gap, m"] == UNDEFINED
    assert row_of(table, "all")["primary"] == "5"


def test_runtime_by_stage_and_the_papers_with_its_hardware() -> None:
    table = named(group_by_data_set(workspace_sheets(), runtime_tables), "runtime-adv")
    assert [row[0] for row in table.rows] == ["sampling", "physics", "scoring", "rendering", "other", "all"]
    assert row_of(table, "physics") == {
        **{"stage": "physics", "total, s": "30.00", "each, s": "6.00", "% of total": "42.9", "paper, s": "211.36"}
    }
    # Attempts and rendered scenes are counted apart: 62 s over 5 attempts and 8 s over 2 scenes.
    assert row_of(table, "rendering")["each, s"] == "4.00"
    assert row_of(table, "all")["each, s"] == f"{62 / 5 + 8 / 2:.2f}"
    assert row_of(table, "all")["paper, s"] == "818.62" and row_of(table, "other")["paper, s"] == UNDEFINED
    assert any("Xeon Platinum 8457C" in note and "L20" in note for note in table.notes)


def test_nothing_timed_is_undefined_and_not_zero() -> None:
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


def test_studies_of_one_planner_have_tables_of_their_own_and_a_copy_has_none() -> None:
    (tables,) = ablation_tables([study(), study(seed=1), study("q"), study()]).values()
    names = [table.name for table in tables]
    assert len(set(names)) == 3 and names[2] == "ablation-q"
    assert all(name.startswith("ablation-p-") for name in names[:2])


def test_a_row_that_nobody_knows_has_no_published_value() -> None:
    known = study()
    other = known.model_copy(update={"rows": (known.rows[0].model_copy(update={"name": "<b>mine</b>"}),)})
    table = named(ablation_tables([other]), "ablation-p")
    assert row_of(table, "<b>mine</b>")["paper"] == UNDEFINED
    assert "<b>" not in table.markdown() and "mine" in other.table().plain()


def test_a_record_that_quotes_the_paper_in_its_rows_is_the_same_study(tmp_path: Path) -> None:
    known = study()
    stored = known.model_dump(mode="json", by_alias=True)
    assert all("paper_rate" not in row for row in stored["rows"])
    for row, quoted in zip(stored["rows"], (0.0617, 0.0349, 0.0013, 0.0080), strict=True):
        row["paper_rate"] = quoted
    for later in ("published_as", "miniature"):
        del stored["planner"][later]
    write_json(tmp_path / "ablation.json", stored)
    (read,) = find_ablations(tmp_path)
    assert read == known and read.content_id == known.content_id


def test_studies_are_found_below_a_folder_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    assert find_ablations(tmp_path / "nowhere") == []
    for planner in ("p", "q"):
        path = tmp_path / "d" / planner / "ablation.json"
        write_json(path, study(planner).model_dump(mode="json", by_alias=True))
    assert [found.planner.name for found in find_ablations(tmp_path)] == ["p", "q"]
    path.write_text("{")
    with pytest.raises(InputError, match=r"q/ablation\.json.*delete or move"):
        find_ablations(tmp_path)


def test_a_study_is_known_by_its_content(tmp_path: Path) -> None:
    again = AblationReport.model_validate(json.loads(json.dumps(study().model_dump(mode="json", by_alias=True))))
    assert again.content_id == study().content_id != study(seed=1).content_id


def test_the_leaderboard_has_them_in_every_form_with_and_without_runs(tmp_path: Path) -> None:
    sheets = workspace_sheets("../mine")
    files = build_leaderboard_files(read_results([], (), sheets, [study()]))
    for name in ("tables/%2E.%2Fmine/runtime-adv", "tables/d/ablation-p", "published/published"):
        assert {f"{name}{suffix}" for suffix in (".tex", ".csv", ".json")} <= set(files)
    text = files["README.md"].decode()
    assert "ablation of the search with p" in text and "manoeuvres of adversaries, and their places" in text
    assert csv_rows(files["tables/d/ablation-p.csv"].decode())[0]["paper"] == "6.17"
    write_leaderboard(read_results([], (), sheets, [study()]), tmp_path)
    assert find_stale_files(read_results([], (), sheets, [study()]), tmp_path) == []
    again = split_sheet("adv", data="../mine", statistics=STATISTICS, runtime={**RUNTIME, "attempts": 6})
    changed = sheets_of(again)
    assert any(
        "runtime-adv.json" in sentence
        for sentence in find_stale_files(read_results([], (), changed, [study()]), tmp_path)
    )


def test_published_values_are_those_of_the_paper() -> None:
    if not PAPER.is_file():
        pytest.skip("the paper is not here")
    text = PAPER.read_text()
    lines = [line.replace("\\%", "") for line in text.splitlines()]
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
