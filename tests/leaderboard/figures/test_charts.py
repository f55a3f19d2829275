"""Figures: the same records give the same bytes, nothing is drawn of nothing, names are only text."""

import io
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import matplotlib as mpl
import pytest
from matplotlib.image import imread

from benchmark.records.run import RunRecord
from benchmark.records.run_schema import SceneFacts
from benchmark.report.plots import DARK, LIGHT
from leaderboard.figures.charts import disagreement_figure, manoeuvre_figure, rates_over_horizon, run_figures
from leaderboard.frame.runs import DataSetRuns
from tests.benchmark.metrics.made_attacks import attacked, told
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made

HOSTILE = ("$x_{1$ \\frac", "<script>&--", "a\x00b\nc", "日本語", "x" * 500, "")


def run(name: str, hits: int, *, split: str = "adv", manoeuvres: bool = True) -> RunRecord:
    """A planner that fails the first ``hits`` of twelve scenes."""
    scenes = {f"s{index:02}": [HIT if index < hits else CLEAN, CLEAN] for index in range(12)}
    record = hand_made(name, scenes, split=split, protocols=("exact", "uniad"))
    facts = {
        scene: SceneFacts(source=scene, manoeuvre="cut-in-left" if place % 3 else None)
        for place, scene in enumerate(scenes)
    }
    return replace(record, run=record.run.model_copy(update={"scene_facts": facts})) if manoeuvres else record


def names_of(*records: RunRecord) -> list[str]:
    return [figure.name for figure in run_figures(DataSetRuns("d", records))]


def test_what_the_records_allow_is_drawn() -> None:
    both = ["rates-exact", "manoeuvres-exact", "disagreement-val", "disagreement-adv"]
    assert names_of(run("a", 3), run("a", 1, split="val")) == both
    assert names_of(run("a", 3, manoeuvres=False)) == ["rates-exact", "disagreement-adv"]
    assert names_of() == []
    assert manoeuvre_figure(DataSetRuns("d", [run("a", 3, split="val")]), "exact") is None
    assert rates_over_horizon(DataSetRuns("d", [run("a", 3)]), "vad") is None
    assert disagreement_figure(DataSetRuns("d", [run("a", 3)]), "val") is None


def test_where_records_say_whom_contacts_are_with_scenes_in_which_bystanders_are_hit_are_not_failed() -> None:
    letters = {"A-1": "f...", "B-1": "F...", "C-1": "...."}
    record = told(attacked("a", letters, dict.fromkeys(letters, True)))

    def words(run: RunRecord) -> list[str]:
        sketch = manoeuvre_figure(DataSetRuns("d", [run]), "exact")
        assert sketch is not None
        figure = sketch(LIGHT)
        return [text.get_text().strip() for text in (*figure.texts, *figure.axes[0].texts)]

    assert words(record) == ["d: scenes in which the adversary is hit first (red), protocol exact", "1/3"]
    assert words(attacked("a", letters, dict.fromkeys(letters, True))) == [
        *("d: adversarial scenes failed (red), protocol exact", "2/3")
    ]


def test_the_same_records_give_the_same_bytes_in_any_order_and_whatever_the_users_settings() -> None:
    records = [run("a", 3), run("b", 5)]
    first = run_figures(DataSetRuns("d", records))
    with mpl.rc_context({"font.size": 30, "svg.hashsalt": "other", "axes.facecolor": "red"}):
        assert run_figures(DataSetRuns("d", records[::-1])) == first
    other = run_figures(DataSetRuns("d", [run("a", 4), *records[1:]]))
    assert all(mine.png != theirs.png for mine, theirs in zip(first[:2], other[:2]))


def test_names_from_strangers_are_only_text() -> None:
    for figure in run_figures(DataSetRuns("$d_{", [run(name, 2) for name in HOSTILE])):
        assert b"<script" not in figure.svg
        ElementTree.fromstring(figure.svg)


@pytest.mark.parametrize("count", [1, 5])
def test_any_number_of_planners_is_drawn_with_letters_of_eleven_pixels_and_light_ones_on_dark(count: int) -> None:
    figures = run_figures(DataSetRuns("d", [run(f"planner-{index}", index) for index in range(count)]))
    for figure in figures:
        sizes = [float(size) for size in re.findall(rb"scale\(([0-9.]+) -", figure.svg)]
        assert imread(io.BytesIO(figure.png))[..., :3].std() > 0.02
        ElementTree.fromstring(figure.svg)
        # Glyphs are drawn in hundredths of a point; 96 pixels of a page are 72 points.
        assert sizes and min(sizes) * 100 * 96 / 72 >= 11.0
        dark = figure.dark()
        assert dark != figure.svg and DARK.paper.encode() in dark and LIGHT.ink.encode() not in dark
