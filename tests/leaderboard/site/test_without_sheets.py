"""Scene pages where no sheet was ever made: the plans stand on a plain grid, whatever kind of plan there is."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from benchmark.machine.storage import content_key
from benchmark.records.row_schema import PlanRow, SampleRow
from benchmark.records.run import RunRecord
from leaderboard.frame.results import read_results
from leaderboard.site.scene_plans import build_sample
from tests.leaderboard.site.big_workspace import DATA_NAME
from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site, write_site
from tests.leaderboard.site.reading import birdseye
from tests.leaderboard.site.test_scenes import row_of

STRAIGHT: Final = [[0.0, 2.0 * step] for step in range(1, 7)]
STANDING: Final = [[0.0, 0.0]] * 6
BENDING: Final = [[0.05 * step * step, 2.0 * step] for step in range(1, 7)]
KINDS: Final = ("straight", "standing", "bending", "forecasting", "failed", "missing")
"""What the samples of the changed planner are in turn."""


def plan_of(kind: str) -> PlanRow:
    waypoints = {"straight": STRAIGHT, "standing": STANDING}.get(kind, BENDING)
    # At the lidar and along the forward axis: in the ego's frame all of it is straight ahead.
    plan: dict[str, Any] = {"frame": "lidar", "waypoints": waypoints}
    if kind == "forecasting":
        box = [2.0, 9.0, 4.0, 2.0, 1.5708]
        plan["modes"] = [STRAIGHT, BENDING]
        plan["forecasts"] = {"boxes": [box], "trajectories": [[[[2.0, 9.0]] * 6]], "scores": [[1.0]]}
    return PlanRow.model_validate(plan)


def changed(record: RunRecord) -> RunRecord:
    """The record with a sample of every kind in turn; those that are missing were never run."""
    rows: list[SampleRow] = []
    for number, row in enumerate(record.rows):
        kind = KINDS[number % len(KINDS)]
        if kind == "missing":
            continue
        update: dict[str, Any] = {"plan": plan_of(kind), "status": "ok", "error": None, "diagnosis": None}
        if kind == "failed":
            update |= {"plan": None, "status": "failed", "error": "ValueError: NaN in the plan", "outcomes": {}}
        rows.append(row.model_copy(update=update))
    return replace(record, rows=tuple(rows))


@pytest.fixture(scope="module")
def without_sheets(site: Site, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``index.html`` of a site of the same records, one planner of them changed, without any sheet."""
    folder = tmp_path_factory.mktemp("without-sheets")
    plain = site.made.planners[1]
    write_site(
        read_results([changed(record) if record.planner == plain else record for record in site.records]), folder
    )
    return folder / "index.html"


@pytest.mark.parametrize("kind", ["straight", "standing", "bending", "forecasting"])
def test_a_plan_of_every_kind_has_its_headings(kind: str) -> None:
    entry = build_sample(row_of(plan_of(kind)), np.zeros(3), [], {})
    assert isinstance(entry["yaw"], list)
    assert len(entry["path"]) == 14
    assert json.dumps(entry)


def test_every_scene_page_has_its_plans_on_a_grid(browser: Browser, site: Site, without_sheets: Path) -> None:
    planner = site.made.planners[1]
    for scene in site.made.scenes[::4]:
        split = "adv" if scene in site.made.adversarial else "val"
        key = content_key(DATA_NAME, split, scene)[:16]
        browser.open(f"#/scene/{key}?model={planner}", start=without_sheets.as_uri())
        last = int(str(browser.one("player-scrub").get_attribute("max")))
        assert browser.all("player-cameras") == []
        for frame in range(last + 1):
            browser.choose("player-scrub", str(frame))
            browser.frames(1)
    assert "plain grid" in browser.js("return document.querySelector('main').textContent;")


def test_a_straight_plan_is_drawn_and_comparisons_have_a_grid_each(
    browser: Browser, site: Site, without_sheets: Path
) -> None:
    key = content_key(DATA_NAME, "adv", site.made.adversarial[0])[:16]
    first, second = site.made.planners[:2]
    browser.open(f"#/scene/{key}?model={second}&t=0", start=without_sheets.as_uri())
    browser.one("player-scrub")
    shown = birdseye(browser)
    browser.click(next(box for box in browser.all("player-model") if box.get_property("value") == second))
    assert birdseye(browser) != shown
    browser.open(f"#/compare/{key}?a={first}&b={second}", start=without_sheets.as_uri())
    browser.one("player-scrub")
    assert len(browser.all("player-birdseye")) == 2


def test_a_scene_that_cannot_be_read_says_so(browser: Browser, site: Site, without_sheets: Path) -> None:
    key = content_key(DATA_NAME, "adv", site.made.adversarial[0])[:16]
    script = without_sheets.parent / "data" / "scenes" / f"{key}.js"
    text = script.read_text(encoding="ascii")
    # Damaged in a sample, which is unpacked long after the script was loaded.
    script.write_text(text.replace('"path":[', '"way":['), encoding="ascii")
    try:
        browser.open(f"#/scene/{key}", start=without_sheets.as_uri())
        assert browser.one("error").text.endswith(".")
    finally:
        script.write_text(text, encoding="ascii")
    assert any("TypeError" in message for message in browser.note_logs())
    browser.forget_logs()
