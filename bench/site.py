"""The site at the size it is meant for: time to write it, its size, first paint from disk, scrubbing.

Run as ``OMP_NUM_THREADS=1 python bench/site.py``; ``--help`` lists the options. Records and sheets are made up
(``tests/leaderboard/site/big_workspace.py``); no planner runs. Python's times are processor time, with workers'. A page
is painted and scrubbed in real time, which other work on the machine changes, so processor time stands beside: of the
page's main thread, and of all that Chromium does.
"""

import argparse
import os
import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.processes import descendants, processor_ticks
from benchmark.machine.workers import processor_seconds, single_threaded
from benchmark.records.run import find_records
from benchmark.records.scene_pages import find_scene_pages
from leaderboard.build import write_leaderboard
from leaderboard.frame.results import read_results
from tests.leaderboard.site.big_workspace import DATA_NAME, make_workspace
from tests.leaderboard.site.browser import Browser, find_chromium, started
from tests.leaderboard.site.reading import key_of, model_query

FIRST_PAINT_AIM_S, SCRUBBING_AIM_HZ = 1.0, 12.0
CELL_WIDTH_PX = 320
ROUTES = {"results": "#/", "planners": "#/planners", "scenes": "#/scenes", "generation": "#/generation"}

_SCRUB = """
const done = arguments[arguments.length - 1];
const scrub = document.querySelector("[data-testid=player-scrub]");
const last = Number(scrub.max);
let frame = 0;
const begin = performance.now();
const step = () => {
  if (frame > last) { done([last + 1, (performance.now() - begin) / 1000]); return; }
  scrub.value = String(frame);
  scrub.dispatchEvent(new Event("input", {bubbles: true}));
  frame += 1;
  requestAnimationFrame(step);
};
requestAnimationFrame(step);
"""
"""Asks for the next frame as soon as the one before is painted; gives their number and the seconds."""
_PAINTED = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"


def timed(what: str, work: Callable[[], Any]) -> Any:
    began = sum(processor_seconds())
    made = work()
    print(f"{what:<52}{sum(processor_seconds()) - began:8.1f} s")
    return made


def folder_size(folder: Path, pattern: str = "**/*") -> int:
    return sum(path.stat().st_size for path in folder.glob(pattern) if path.is_file())


def thread_seconds(browser: Browser) -> float:
    """Processor time of the page's main thread."""
    metrics = browser.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return float(next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration"))


def chromium_seconds(browser: Browser) -> float:
    """Processor time of the driver and all that it started, where the system tells it in ``/proc``; else NaN."""
    process = browser.driver.service.process
    if process is None or not Path("/proc/self/stat").exists():
        return float("nan")
    return sum(map(processor_ticks, [process.pid, *descendants(process.pid)])) / os.sysconf("SC_CLK_TCK")


def paint(browser: Browser, route: str, repeats: int) -> None:
    """First paint of a page, from disk."""
    painted, ready = [], []
    before = chromium_seconds(browser)
    for _ in range(repeats):
        browser.open(route)
        painted.append(browser.until(_PAINTED, patience_s=60) / 1000)
        ready.append(browser.js("return (window.challengerReadyAt ?? NaN) / 1000;"))
    used = (chromium_seconds(browser) - before) / repeats
    print(
        f"{'first paint, ' + route.split('?')[0][:30]:<52}{statistics.median(painted):8.2f} s   worst "
        f"{max(painted):.2f}, page complete {statistics.median(ready):.2f}, processor {used:.2f}   "
        f"(aim {FIRST_PAINT_AIM_S:.0f})"
    )


def scrub(browser: Browser, what: str, route: str, *, everything: bool) -> None:
    """Frames a second while somebody drags through a scene as fast as it goes."""
    browser.open(route)
    browser.one("player-scrub")
    if everything:
        for name in ("player-show-forecasts", "player-show-modes"):
            browser.one(name).click()
    browser.frames(10)
    before, all_before = thread_seconds(browser), chromium_seconds(browser)
    frames, seconds = browser.driver.execute_async_script(_SCRUB)
    own, used = thread_seconds(browser) - before, chromium_seconds(browser) - all_before
    print(
        f"{'scrubbing, ' + what:<52}{frames / seconds:8.1f} frames/s   processor, ms a frame: main thread "
        f"{1e3 * own / frames:.1f}, all {1e3 * used / frames:.0f}   (aim {SCRUBBING_AIM_HZ:.0f})"
    )


def measure_in_browser(index: Path, made: Any, repeats: int) -> None:
    programs = find_chromium()
    if programs is None:
        print("no Chromium with its driver here (make browser): painting and scrubbing were not measured")
        return
    with started(programs, index.as_uri()) as browser:
        browser.driver.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
        note = "addEventListener('DOMContentLoaded', () => { const look = () => { if (window.CHALLENGER_READY) { "
        note += "window.challengerReadyAt = performance.now(); } else { setTimeout(look, 2); } }; look(); });"
        browser.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": note})
        for route in ROUTES.values():
            paint(browser, route, repeats)
        scene = next(name for name in made.adversarial if name.startswith("scene-"))
        key = key_of(scene, "adv")
        paint(browser, f"#/scene/{key}", repeats)
        every = f"#/scene/{key}?{model_query(*made.planners)}"
        scrub(browser, "three planners", f"#/scene/{key}?{model_query(*made.planners[:3])}", everything=False)
        scrub(browser, f"{len(made.planners)} planners", every, everything=False)
        scrub(browser, "all of them with forecasts and modes", every, everything=True)
        pair = f"?a={made.planners[0]}&b={made.planners[1]}"
        scrub(browser, "two planners side by side", f"#/compare/{key}{pair}", everything=False)
        for message in browser.note_logs():
            print(f"console: {message}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=150)
    parser.add_argument("--models", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=3, help="loads of each page")
    parser.add_argument("--at", type=Path, help="folder to work in and to keep; otherwise a temporary one")
    given = parser.parse_args()
    single_threaded()
    with tempfile.TemporaryDirectory() as temporary:
        out = given.at or Path(temporary)
        print(f"{given.scenes} scenes, {given.models} planners, data set {DATA_NAME!r}, in {out}")
        made = timed(
            "made up records and sheets",
            lambda: make_workspace(out, given.scenes, given.models, cell_width_px=CELL_WIDTH_PX),
        )
        records = timed("read the records", lambda: find_records(out / "runs"))
        sheets = timed("read the sheets", lambda: find_scene_pages(out / "sheets"))
        folder = out / "leaderboard"
        timed(
            "write tables and figures",
            lambda: write_leaderboard(read_results(records, sheets=sheets), folder, site=False),
        )
        timed("write them and the site", lambda: write_leaderboard(read_results(records, sheets=sheets), folder))
        site = folder / "site"
        scripts = [path.stat().st_size for path in (site / "data" / "scenes").iterdir()]
        print(f"{'index.js':<52}{folder_size(site, 'data/index.js') / 1e6:8.2f} MB   (aim 2)")
        print(f"{'largest script of a scene':<52}{max(scripts) / 1e6:8.2f} MB   (aim 0.5)")
        of_media = folder_size(site / "media") / 1e6
        print(f"{'all files':<52}{folder_size(site) / 1e6:8.1f} MB   of this media {of_media:.1f}")
        measure_in_browser(site / "index.html", made, given.repeats)


if __name__ == "__main__":
    main()
