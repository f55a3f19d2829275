"""The paper's tables in the paper's layout, and that LaTeX sets them."""

import re
import shutil
import subprocess
from dataclasses import asdict
from pathlib import Path

import pytest

from benchmark.published import ADV_NUSC, HYPER_PARAMETERS, RUNTIME_S
from benchmark.report.table import LatexForm, build_table, escape_latex
from generation.search.hyperparameters import HyperParameters
from leaderboard.build import write_leaderboard
from leaderboard.frame.results import read_results
from leaderboard.frame.specification import group_by_data_set
from leaderboard.paper.appendix import hyper_parameter_tables, paper_data_set_tables, paper_runtime_tables
from leaderboard.paper.document import PREAMBLE, paper_table_1
from leaderboard.paper.runtime_chart import compute_runtime_shares, runtime_charts
from tests.leaderboard.csv_rows import csv_rows
from tests.leaderboard.made_up import sheets_of, split_sheet, study
from tests.leaderboard.paper.papers import AS_PRINTED, OWN, paper_runs, paper_sheets


def test_table_1_has_two_planners_beside_each_other_as_in_the_paper() -> None:
    table = paper_table_1("d", paper_runs())
    assert table is not None and len(table.columns) == 17 and table.columns[1:9] == table.columns[9:]
    assert [row[0] for row in table.rows] == ["val", "val-r", "adv"] * 3
    names = [(row[1], row[9]) for row in table.rows]
    pairs = [("uniad", "sparsedrive"), ("vad-base", "diffusiondrive"), ("constant-velocity", "idm")]
    assert names == [pair for pair in pairs for _ in range(3)]
    # Print shows the name once, in the middle of its three lines.
    lines = [line.split("&") for line in table.latex().splitlines() if line.strip().startswith(("val", r"\textbf{adv"))]
    assert [(line[1].strip(), line[9].strip()) for line in lines] == [
        name if place % 3 == 1 else ("", "") for place, name in enumerate(names)
    ]


def test_rates_are_those_of_the_records_and_published_ones_have_their_own_columns() -> None:
    runs = paper_runs()
    table = paper_table_1("d", runs)
    assert table is not None and table.cells is not None
    adv = next(run for run in runs if run.planner == "uniad" and run.run.split == "adv")
    val = next(run for run in runs if run.planner == "uniad" and run.run.split == "val")
    rates = [run.summary.protocols["uniad"].columns["collision"]["avg"].value for run in (val, adv)]
    assert rates[0] is not None and rates[1] is not None and rates[0] > 0
    row = table.rows[2]
    assert row[5] == f"{100 * rates[1]:.2f}" and row[6] == f"{(rates[1] - rates[0]) / rates[0]:.1f}×"
    assert row[7:9] == ("3.95", "12.6×") and table.rows[0][7:9] == ("0.29", "")
    cell = table.cells[2][7]
    assert cell is not None and cell.source is not None and cell.record is None and cell.protocol == "uniad"
    # SparseDrive is printed with three digits; who is not in the paper has no published number.
    assert re.fullmatch(r"\d+\.\d{3}", row[13]) and row[15] == "1.026"
    assert table.rows[-1][7:9] == table.rows[-1][15:] == ("", "")


def test_an_odd_number_of_planners_and_missing_splits_leave_dashes() -> None:
    runs = [run for run in paper_runs() if run.planner in ("uniad", "vad-base", "sparsedrive")]
    table = paper_table_1("d", [run for run in runs if (run.planner, run.run.split) != ("uniad", "val-r")])
    assert table is not None and len(table.rows) == 6
    assert table.rows[1][2] == "–" and table.rows[4][9:] == ("",) * 8
    assert paper_table_1("d", []) is None


def test_hyper_parameters_stand_beside_the_printed_ones_and_differences_are_named() -> None:
    (table,) = hyper_parameter_tables(paper_sheets(), [])["d"]
    assert [(row[0], row[-1]) for row in table.rows] == list(HYPER_PARAMETERS.items())
    differing = [row[0] for row in table.rows if row[1] != row[2]]
    assert differing == ["#Refinement Rounds"] and table.rows[-1][1:] == ("7", "5")
    assert table.notes[0] == "adv differs from the paper in #Refinement Rounds."
    searched = study().model_copy(update={"hyper": AS_PRINTED})
    (of_study,) = hyper_parameter_tables(sheets_of(), [searched])["d"]
    assert of_study.notes[0] == "As the paper prints them: ablation, p."
    assert hyper_parameter_tables(sheets_of(split_sheet("val")), []) == {}


def test_the_defaults_of_the_search_are_as_printed() -> None:
    sheet = split_sheet("adv").model_copy(update={"hyper": asdict(HyperParameters())})
    (table,) = hyper_parameter_tables(sheets_of(sheet), [])["d"]
    assert table.notes[0] == "As the paper prints them: adv."


def test_runtime_and_data_set_are_as_the_paper_has_them() -> None:
    sheets = paper_sheets()
    (runtime,) = group_by_data_set(sheets, paper_runtime_tables)["d"]
    assert [row[0] for row in runtime.rows] == [
        "Traj. sampling", "Physics", "Traj. scoring", "Rendering", "Other", "Total"
    ]  # fmt: skip
    assert [row[2] for row in runtime.rows] == ["17.36", "211.36", "194.72", "395.18", "–", "818.62"]
    assert float(runtime.rows[-1][1]) == pytest.approx(sum(float(row[1]) for row in runtime.rows[:-1]))
    (data_set,) = group_by_data_set(sheets, paper_data_set_tables)["d"]
    assert data_set.columns == ("Attribute", "val", "adv", "Adv-nuSc")
    assert [row[-1] for row in data_set.rows] == [f"{count:,}" for count in ADV_NUSC.values()]


def test_the_chart_shows_shares_that_are_a_whole() -> None:
    sheets = paper_sheets()
    shares = compute_runtime_shares(sheets.splits["d", "adv"])
    assert sum(shares.values()) == pytest.approx(1.0) and set(RUNTIME_S) <= set(shares)
    # Five attempts took 10 s of sampling, two scenes 8 s of rendering.
    assert shares["sampling"] / shares["rendering"] == pytest.approx((10 / 5) / (8 / 2))
    (chart,) = runtime_charts("d", sheets)
    assert chart.name == "runtime-adv" and chart.png.startswith(b"\x89PNG") and chart.svg != chart.dark()
    assert runtime_charts("d", sheets_of(split_sheet("val"))) == ()
    assert runtime_charts("d", sheets)[0] == chart


def test_a_leaderboard_has_them_all_and_one_document(written: Path) -> None:
    folder, wanted = written / "paper" / "d", ("table-1", "hyper-parameters", "runtime-adv", "data-set")
    document = (folder / "paper.tex").read_text()
    every = [text for text in (written / "tables.tex").read_text().split("\n\n") if "label{tab:paper-" in text]
    assert len(every) == len(wanted) and all(text.strip() in document for text in every)
    assert {f"paper-{name}" for name in wanted} == {
        row["from table"] for row in csv_rows((written / "tables" / "paper.csv").read_text())
    }
    assert "{paper-runtime-0.png}" in document and (folder / "paper-runtime-0.png").is_file()
    assert "the paper's layout" in (written / "README.md").read_text()


def test_latex_is_laid_out_as_asked() -> None:
    form = LatexForm("l|r", rules_after=(1,), bold_rows=(1,), fit=True)
    text = build_table("t", "T", ("a", "b"), [("x", "1"), ("y", "")], latex_form=form).latex()
    assert r"\begin{tabular}{l|r}" in text and r"\resizebox{\textwidth}{!}{%" in text and r"\end{tabular}}" in text
    assert text.index(r"x & 1 \\") < text.rindex(r"\midrule") < text.index(r"\textbf{y} &  \\")
    # Letters that LaTeX may not have are numbers.
    assert escape_latex('a < b | "é" ≠ 字') == r"a \textless{} b \textbar{} {''}é{''} U+2260 U+5B57"


def compiled(folder: Path, name: str) -> str:
    """What LaTeX says of a document, which it must set."""
    if (found := shutil.which("pdflatex")) is not None:
        command = [found, "-interaction=nonstopmode", "-halt-on-error", "-no-shell-escape"]
    elif (found := shutil.which("tectonic")) is not None:
        command = [found, "--only-cached"]
    else:
        pytest.skip("no LaTeX here (pdflatex or tectonic); Debian has it in texlive-latex-recommended")
    done = subprocess.run([*command, name], cwd=folder, capture_output=True, timeout=300, check=False)
    said = done.stdout.decode(errors="replace") + done.stderr.decode(errors="replace")
    assert done.returncode == 0, said[-2000:]
    assert (folder / name).with_suffix(".pdf").read_bytes().startswith(b"%PDF")
    return said


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, results = tmp_path_factory.mktemp("board"), read_results(paper_runs(), (), paper_sheets(), [study()])
    write_leaderboard(results, folder, site=False)
    return folder


def test_latex_sets_the_paper_s_tables_within_the_page(written: Path) -> None:
    said = compiled(written / "paper" / "d", "paper.tex")
    assert "Overfull" not in said


def test_latex_sets_every_table_of_a_leaderboard(written: Path) -> None:
    text = (written / "tables.tex").read_text().replace(r"\end{table}", "\\end{table}\n\\clearpage")
    assert text.count(r"\clearpage") > 10
    document = "\n".join([PREAMBLE, r"\begin{document}", text, r"\end{document}", ""])
    (written / "all.tex").write_text(document)
    compiled(written, "all.tex")
    assert set(OWN) <= set(re.findall(r"[a-z-]+", document))
