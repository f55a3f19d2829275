"""From records to files: the same bytes whatever the order, and nothing in one table that does not belong together."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest

from adapters.planners.log_replay import LogReplay
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.storage import write_bytes
from benchmark.records.drives import DriveRecord
from benchmark.records.run import RunRecord, find_records
from benchmark.records.run_schema import SceneFacts
from leaderboard.build import build_leaderboard_files, build_leaderboard_tables, find_stale_files, write_leaderboard
from leaderboard.figures.contents import attack_figures
from leaderboard.frame.results import read_results
from leaderboard.results import select_runs
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Straight
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made
from tests.benchmark.records.test_drives import contact, written
from tests.benchmark.records.test_drives import row as drive_row

FIRST_SCENE = EvalSettings(scenes=("scene-9901",))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunRecord, ...]:
    """Two planners on val and adv; driving on at 8 m/s hits the slow leader of adv."""
    out = tmp_path_factory.mktemp("runs")
    for planner in (Straight(), LogReplay()):
        evaluate(town_of_two(), "val", planner, out)
        evaluate(town_of_two(slow_leader=True), "adv", planner, out)
    return tuple(find_records(out))


def without_figures(patch: pytest.MonkeyPatch) -> None:
    """Figures have tests of their own; here one test has them drawn, because each takes half a second."""
    patch.setattr("leaderboard.figures.contents.RUN_FIGURES", (attack_figures,))
    for name in ("draw_heat_maps", "draw_lift_maps"):
        patch.setattr(f"leaderboard.figures.contents.{name}", lambda _: (b"", b"", lambda: b""))


@pytest.fixture(autouse=True)
def few_figures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "drawn" not in request.fixturenames:
        without_figures(monkeypatch)


@pytest.fixture
def drawn() -> None:
    """Asks for figures."""


def texts(records: Sequence[RunRecord]) -> dict[str, str]:
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        files = build_leaderboard_files(read_results(records)).items()
    return {name: content.decode() for name, content in files if not name.endswith(".png")}


@pytest.fixture(scope="module")
def files(runs: tuple[RunRecord, ...]) -> dict[str, str]:
    """Text files of their leaderboard."""
    return texts(runs)


def rows_of(files: Mapping[str, str], table: str) -> list[dict[str, str]]:
    """Rows of a table in the file of its kind; of each the columns that the table has."""
    rows = csv.DictReader(io.StringIO(files[f"tables/{table.partition('-')[0]}.csv"]))
    of_table = [row for row in rows if row["from table"] == table]
    heads = [head for head in of_table[0] if any(row[head] for row in of_table)]
    return [{head.partition(" | ")[0]: row[head] for head in heads} for row in of_table]


def named(record: RunRecord, *, data: str | None = None, planner: str | None = None) -> RunRecord:
    run = record.run
    facts = run.data.model_copy(update={"name": data or run.data.name})
    who = run.planner.model_copy(update={"name": planner or run.planner.name})
    return replace(record, run=run.model_copy(update={"data": facts, "planner": who}))


def test_the_same_records_give_the_same_bytes(runs: tuple[RunRecord, ...], drawn: None) -> None:
    files = build_leaderboard_files(read_results(runs), figures=True)
    assert build_leaderboard_files(read_results(runs[::-1]), figures=True) == files
    assert [name for name in files if name.endswith(".png")] == [
        "figures/fake/transfer-val-exact.png",
        "figures/fake/transfer-adv-exact.png",
        "figures/fake/transfer-adv-adversary.png",
        "figures/fake/lift-val-exact.png",
        "figures/fake/lift-adv-adversary.png",
        "figures/fake/rates-exact.png",
        "figures/fake/disagreement-val.png",
        "figures/fake/disagreement-adv.png",
    ]


def test_one_row_for_each_planner_and_split_with_what_was_counted(files: dict[str, str]) -> None:
    rows = rows_of(files, "collision-exact")
    named = ("straight", "log-replay †")
    assert [(row["planner"], row["split"]) for row in rows] == [*product(named, ("val", "adv"))]
    assert rows[0]["col. 3s"] == "0.00" and float(rows[1]["col. 3s"]) > 0.0
    assert {(row["samples"], row["scenes"], row["coverage"]) for row in rows} == {("20", "2", "100.0")}
    assert rows[1]["scenes failed"] == "1/2"


def test_what_is_written_is_current_until_something_changes(runs: tuple[RunRecord, ...], tmp_path: Path) -> None:
    """Also: what is no longer made or asked for, as tables of earlier releases, is stale and goes with the next one."""
    results = read_results(runs)
    written = write_leaderboard(results, tmp_path, figures=True)
    assert all(path.is_file() for path in written)
    assert find_stale_files(results, tmp_path, figures=True) == []
    (tmp_path / "tables" / "notes.txt").write_text("mine")
    write_bytes(tmp_path / "tables" / "fake" / "collision-exact.tex", b"of an earlier release")
    stale = [sentence for sentence in find_stale_files(results, tmp_path) if "site" not in sentence]
    gone = {sentence.rpartition(" is no longer ")[0].rpartition("/")[2] for sentence in stale}
    assert gone >= {"collision-exact.tex", "transfer-adv-exact.png", "transfer-adv-exact.svg"}
    write_leaderboard(results, tmp_path)
    assert find_stale_files(results, tmp_path) == []
    assert [path for path in tmp_path.glob("*/fake/*") if path.parts[-3] in ("tables", "figures")] == []
    assert (tmp_path / "tables" / "notes.txt").read_text() == "mine"
    (tmp_path / "README.md").write_text("edited")
    (tmp_path / "published.csv").unlink()
    assert sorted(sentence.rpartition("/")[2] for sentence in find_stale_files(results, tmp_path)) == [
        "README.md differs from the run records",
        "published.csv is missing",
    ]


def test_a_run_of_some_scenes_does_not_displace_or_clash_with_the_whole(
    runs: tuple[RunRecord, ...], tmp_path: Path
) -> None:
    part = evaluate(town_of_two(), "val", Straight(), tmp_path, FIRST_SCENE)
    assert not part.covers_split and part not in select_runs([*runs, part])
    assert select_runs([*runs, part]) == select_runs([part, *runs]) == select_runs(runs)


def test_where_there_is_only_a_part_the_largest_stands_and_says_so() -> None:
    parts = [
        hand_made("straight", {scene: [HIT] for scene in scenes}, split="val", scenes_in_split=3)
        for scenes in ("a", "ab", "c")
    ]
    assert select_runs(parts) == select_runs(parts[::-1]) == [parts[1]]
    files = texts(parts)
    assert "straight on val: 2 of 3 scenes of the split." in files["README.md"]
    assert not any("transfer" in name for name in files)


def test_two_whole_runs_of_one_planner_are_refused(runs: tuple[RunRecord, ...]) -> None:
    again = replace(runs[0], directory=runs[0].directory.with_name("again"))
    with pytest.raises(InputError, match="both hold log-replay on split adv"):
        build_leaderboard_files(read_results([*runs, again]))


def test_records_of_different_content_under_one_name_are_refused(runs: tuple[RunRecord, ...]) -> None:
    other = hand_made("p", {"a": [HIT]}, split="val", data="fake")
    with pytest.raises(InputError, match=r"different content of split val of fake .*run challenger-bench eval again"):
        build_leaderboard_files(read_results([*runs, other]))
    assert build_leaderboard_tables([*runs, named(other, data="another")])


def test_adversarial_scenes_under_the_name_of_another_split_are_refused() -> None:
    adversarial, recorded = (hand_made("p", {"a": [HIT]}, split=split) for split in ("adv", "val"))
    assert len(select_runs([adversarial, recorded])) == 2
    facts = {"a": SceneFacts(source="a", manoeuvre="cut-in-left")}
    same, attacked = (
        replace(recorded, run=recorded.run.model_copy(update=update))
        for update in ({"data": adversarial.run.data}, {"scene_facts": facts})
    )
    with pytest.raises(InputError, match="the same scenes of d as split val and as split adv"):
        select_runs([adversarial, same])
    with pytest.raises(InputError, match="with a generated adversary"):
        select_runs([attacked])


def test_published_numbers_are_in_no_table_of_ours(runs: tuple[RunRecord, ...]) -> None:
    files = texts([named(runs[0], data="published")])
    assert "UniAD" in files["published.csv"] and "not ours" in files["README.md"]
    ours = [text for name, text in files.items() if name.startswith("tables/")]
    assert len(ours) > 2 and not any("UniAD" in text for text in ours)


def test_transfer_shows_counts_and_a_dash_where_the_surrogate_never_fails() -> None:
    scenes = {"straight": HIT, "elsewhere": CLEAN, "seer": CLEAN}
    runs = [hand_made(name, {"a": [first], "b": [CLEAN]}, privileged=name == "seer") for name, first in scenes.items()]
    rows = rows_of(texts(runs), "transfer-adv-exact")
    by_surrogate = {row["surrogate"]: row for row in rows}
    assert by_surrogate["straight"]["its failed scenes"] == "1"
    assert [row["surrogate"] for row in rows] == ["elsewhere", "straight", "seer †", "all scenes"]
    assert by_surrogate["straight"]["elsewhere"] == "0 (0/1)"
    assert by_surrogate["elsewhere"]["its failed scenes"] == "0"
    assert by_surrogate["elsewhere"]["straight"] == by_surrogate["elsewhere"]["elsewhere"] == ""
    everywhere = by_surrogate["all scenes"]
    assert (everywhere["straight"], everywhere["elsewhere"]) == ("50 [0, 100] (1/2)", "0 (0/2)")


def test_names_from_strangers_records_stay_inside_the_folder(runs: tuple[RunRecord, ...], tmp_path: Path) -> None:
    folder, names = tmp_path / "board", ["../../evil", "..", "a/b", ".hidden", "README.md"]
    # Two planners on one split, which have figures.
    strange = [named(record, data=name) for name in names for record in runs if record.run.split == "adv"]
    for path in write_leaderboard(read_results(strange), folder, figures=True):
        assert path.resolve().is_relative_to(folder.resolve())
    assert [path.name for path in tmp_path.iterdir()] == ["board"]
    assert len(list((folder / "figures").iterdir())) == len(names)
    assert sorted(path.name for path in folder.iterdir()) == [
        "README.md", "figures", "paper", "published.csv", "site", "tables", "tables.json", "tables.tex",
    ]  # fmt: skip


def test_a_hostile_planner_name_stays_text_everywhere(runs: tuple[RunRecord, ...]) -> None:
    hostile = "[x]|<script>&\\end{table}%\n\n# Head"
    files = texts([named(record, planner=hostile) if record.planner == "straight" else record for record in runs])
    text = files["README.md"]
    assert "<script>" not in text and "\n# Head" not in text
    for section in text.split("###")[1:]:
        lines = [line.replace("\\|", "") for line in section.splitlines() if line.startswith("|")]
        assert len({line.count("|") for line in lines}) == 1
    latex = files["tables.tex"]
    assert latex.count(r"\end{table}") == latex.count(r"\begin{table}") == len(json.loads(files["tables.json"]))
    assert "{[}x]" in latex and r"&\end" not in latex


def test_a_note_is_said_once_in_the_readme_and_below_every_table_elsewhere(files: dict[str, str]) -> None:
    legend = "† privileged: sees"
    assert files["README.md"].count(legend) == 1
    assert files["tables.tex"].replace(r"$\dagger$", "†").count(legend) > 3


def test_few_files_hold_every_table_and_no_two_protocols_share_a_column(files: dict[str, str]) -> None:
    tables = json.loads(files["tables.json"])
    assert len(files) < 30 < len(tables)
    stacked: dict[tuple[str, str], int] = {}
    for name in [name for name in files if name.endswith(".csv")]:
        for row in csv.DictReader(io.StringIO(files[name])):
            table = row["from data set"], row["from table"]
            stacked[table] = stacked.get(table, 0) + 1
            if table[1].startswith("collision-") and table[1] != "collision-native":
                judge = table[1].removeprefix("collision-")
                assert all(head.endswith(judge) for head, text in row.items() if text and head.startswith("col. "))
    assert stacked == {(table["data set"], table["name"]): len(table["rows"]) for table in tables if table["rows"]}
    collision = next(table for table in tables if table["name"] == "collision-vad")
    (row, *_) = rows_of(files, "collision-vad")
    assert row["col. 3s"] == collision["rows"][0][collision["columns"].index("col. 3s")]


def test_drives_have_tables_beside_open_loop(
    runs: tuple[RunRecord, ...], files: dict[str, str], tmp_path: Path
) -> None:
    beside = build_leaderboard_files(read_results(runs[::-1], drives=driven_beside(runs, tmp_path)))
    read, found = beside["README.md"].decode(), {name: text.decode() for name, text in beside.items()}
    for said in ("## fake: closed loop", "closed loop, engine default, agents replay", "beside open loop"):
        assert said in read
    assert "tables/loops.csv" in read and "only open" in found["tables/loops.csv"]
    for kind in ("drives", "loops", "loops-scenes"):
        (row, *_) = rows_of(found, f"{kind}-adv-default-replay")
        assert row["planner"].startswith("straight")
    assert {name for name in files if name.startswith("tables")} < set(beside)


def test_drives_alone_make_a_leaderboard_and_go_stale(runs: tuple[RunRecord, ...], tmp_path: Path) -> None:
    driven, folder = driven_beside(runs, tmp_path / "drives"), tmp_path / "board"
    write_leaderboard(read_results((), drives=driven), folder)
    assert find_stale_files(read_results((), drives=driven), folder) == []
    assert b'"closed loop"' in (folder / "site/data/index.js").read_bytes()
    fewer = find_stale_files(read_results(runs[:1]), folder)
    assert any("tables/drives.csv" in one and "no longer produced" in one for one in fewer)
    scenes = driven[0].facts.scenes
    hits = [drive_row(scene, end="contact", contact=contact()) for scene in scenes]
    facts = {"data": driven[0].facts.data.model_dump(), "scenes": scenes, "scenes_in_split": len(scenes)}
    changed = [written(tmp_path / "changed", *hits, **facts)]
    stale = find_stale_files(read_results((), drives=changed), folder)
    assert any("tables/drives.csv differs" in one for one in stale)


def driven_beside(runs: Sequence[RunRecord], folder: Path) -> list[DriveRecord]:
    """Drives without a contact of the planner that drives on, on the scenes of its run on adv."""
    (run,) = [one.run for one in runs if one.planner == "straight" and one.run.split == "adv"]
    rows = [drive_row(scene) for scene in run.scenes]
    facts = {"planner": run.planner.model_dump(), "data": run.data.model_dump(), "scenes": run.scenes}
    return [written(folder, *rows, scenes_in_split=len(rows), **facts)]
