"""Drives on the site: scripts that say where the ego was, and a page that plays them."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.records.drives import DriveRecord
from benchmark.records.scene_pages import ScenePage, ScenePages
from benchmark.records.search_trace import SearchTraceFrame, write_search_trace
from leaderboard.frame.results import read_results
from leaderboard.site.drive_data import build_drive_files, build_drive_index, interpolate_poses
from leaderboard.site.scene_data import build_agent
from leaderboard.site.scene_facts import scene_key
from tests.benchmark.records.test_drives import contact, row, written
from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site, write_site
from tests.leaderboard.site.reading import birdseye
from tests.leaderboard.site.test_index import value_of

EVERYBODY, ADVERSARY = "The others are where the recording has them.", "Orange is the adversary as it drove."


def drive_of(folder: Path, sheet: ScenePage, agents: str = "replay", **changes: Any) -> DriveRecord:
    """Three seconds at 4 m/s, 2 m beside where the recorded ego began, on a sheet's scene, to a contact at 2.3 s."""
    times = [sheet.timestamps_us[0] + 500_000 * tick for tick in range(7)]
    x, y = (place + at for place, at in zip(sheet.origin_m, (sheet.ego.x_m[0], sheet.ego.y_m[0])))
    ego = [[x + 2.0 * tick, y + 2.0, 0.0, 4.0, 0.0, 0.0, 0.0] for tick in range(7)]
    measured = changes.pop("measured", {"engine": "default", "agents": agents, "sensor": "none"})
    end = {"end": "contact", "contact": {**contact(), "seconds": 1.3}}
    one = row(
        sheet.scene,
        primed=3,
        ticks={"time_us": times, "ego": ego, "command": [2] * 6, "station": [0.0] * 6},
        plans=[{"frame": "ego", "waypoints": [[2.0 * step, 0.0] for step in range(1, 7)]}] * 6,
        **{**end, **changes},
    )
    data = sheet.data.model_dump()
    return written(folder, one, data=data, split=sheet.split, scenes=[sheet.scene], measured=measured)


def first_sheet(site: Site) -> ScenePage:
    return min(site.sheets.scenes.values(), key=lambda stored: stored.sheet.scene).sheet


def steps(values: Sequence[int]) -> list[float]:
    return [0.01 * value for value in np.cumsum(values)]


def test_between_states_the_ego_is_on_a_cubic() -> None:
    ticks = np.array([0.0, 0.5, 1.0])
    even = np.array([[0.0, 0.0, 0.0, 4.0], [2.0, 0.0, 0.0, 4.0], [4.0, 0.0, 0.0, 4.0]])
    found = interpolate_poses(np.array([-1.0, 0.0, 0.125, 0.75, 1.0, 9.0]), ticks, even)
    np.testing.assert_allclose(found[:, 0], [0.0, 0.0, 0.5, 3.0, 4.0, 4.0])
    # From rest to 4 m/s at constant acceleration: the cubic is that parabola.
    begins = np.array([[0.0, 0.0, 3.1, 0.0], [-1.0, 0.0, -3.1, 4.0]])
    halfway = interpolate_poses(np.array([0.25]), ticks[:2], begins)[0]
    assert halfway[0] == pytest.approx(-0.25, abs=0.01) and abs(halfway[2]) > 3.1
    assert interpolate_poses(np.array([0.0, 1.0]), ticks[:1], even[:1]).tolist() == [[0.0, 0.0, 0.0]] * 2


def test_a_script_holds_the_drive_and_nothing_of_others_that_answered(site: Site, tmp_path: Path) -> None:
    sheet = first_sheet(site)
    replayed, answered = (drive_of(tmp_path / name, sheet, name) for name in ("replay", "idm"))
    files, index = (
        build_drive_files([replayed, answered], site.sheets),
        build_drive_index([replayed, answered], site.sheets),
    )
    assert {f"data/scenes/{one['key']}.js" for one in index} == set(files) and len(files) == 2
    assert {one["scene"] for one in index} == {scene_key((sheet.data.name, sheet.split, sheet.scene))}
    of = {one["measured"]: value_of(files[f"data/scenes/{one['key']}.js"]) for one in index}
    drive = of["default, agents replay, sensor none"]
    assert drive["base"] == index[0]["scene"] and "agents" not in drive
    assert of["default, agents idm, sensor none"]["agents"] == []
    assert {EVERYBODY in one["note"] for one in index} == {True, False}
    # The contact is 1.3 s after the last primed instant, at 1 s.
    assert drive["frames"][-1] <= 2.3 < drive["frames"][-1] + 0.09 and drive["contact"]["t"] == pytest.approx(2.3)
    x = steps(drive["ego"]["x"])
    assert x[-1] - x[0] == pytest.approx(4.0 * drive["frames"][-1], abs=0.02)
    assert [sample["t"] for sample in drive["samples"]] == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5][: len(drive["samples"])]
    (model,) = drive["models"]
    assert len(model["samples"]) == len(drive["samples"]) >= 5 and model["name"] == "made"


def test_whoever_touched_the_ego_without_its_fault_is_shown_until_it_is_gone(site: Site, tmp_path: Path) -> None:
    sheet = first_sheet(site)
    agent = next(each for each in sheet.agents if each.first == 0 and len(each.x_m) > 40)
    touch = {**contact(at_fault=False), "seconds": 0.8, "agent": agent.id}
    measured = {"engine": "default", "agents": "replay", "sensor": "none", "until": "fault@1"}
    driven = drive_of(tmp_path, sheet, end="end", contact=None, passed=[touch], measured=measured)
    (said,) = build_drive_index([driven], site.sheets)
    assert "until fault@1" in said["measured"] and EVERYBODY in said["note"] and said["outcome"] == "no contact"
    drive = value_of(build_drive_files([driven], site.sheets)[f"data/scenes/{said['key']}.js"])
    shown = {each["id"]: each for each in drive["agents"]}
    assert len(shown) == len(sheet.agents)
    # Driving begins at 1 s; the planning instant after the touch at 1.8 s is at 2 s.
    left = len(shown[agent.id]["x"])
    assert drive["frames"][left - 1] < 2.0 <= drive["frames"][left] + 0.01
    for each in sheet.agents:
        assert each.id == agent.id or shown[each.id]["x"] == build_agent(each)["x"]


def test_other_content_is_listed_and_not_played(site: Site, tmp_path: Path) -> None:
    sheet = first_sheet(site)
    other = sheet.model_copy(update={"data": sheet.data.model_copy(update={"fingerprint": "e"})})
    driven = [drive_of(tmp_path, other)]
    assert build_drive_files(driven, site.sheets) == {} and build_drive_index(driven, site.sheets)[0]["key"] is None
    assert build_drive_files(driven, ScenePages({}, {})) == {}


def test_a_failed_drive_says_why(site: Site, tmp_path: Path) -> None:
    failure = {"reason": "raised", "text": "Traceback\nValueError: no"}
    failed: dict[str, Any] = {"status": "failed", "end": "failed", "scores": None, "failure": failure, "contact": None}
    driven = drive_of(tmp_path, first_sheet(site), **failed)
    (script,) = build_drive_files([driven], site.sheets).values()
    samples = value_of(script)["models"][0]["samples"]
    assert samples[-1] == {"failed": "ValueError: no"} and "path" in samples[0]


def pursued(folder: Path, sheet: ScenePage, others: str = "replay") -> DriveRecord:
    """A drive in which the sheet's last agent is an adversary from frame 12 on, and what it considered."""
    agent = sheet.agents[-1]
    x, y = sheet.origin_m
    poses = [[x + 5.0 + 0.1 * step, y + 1.0, 0.5] for step in range(17)]
    adversary = {
        "agent": 0,
        "uuid": agent.id,
        "start": 12,
        "poses": poses,
        "replanned": [12, 24],
        "scores": [None, -1.0],
    }
    measured = {"engine": "default", "agents": "adversary", "sensor": "none", "agents_facts": {"others": others}}
    found = drive_of(folder, sheet, adversary=adversary, measured=measured)
    lines = [[[x + 6.0 + 2.0 * at, y + side * at] for at in range(7)] for side in (-1.0, 0.0, 1.0)]
    frames = (
        SearchTraceFrame(frame=12, time_us=sheet.timestamps_us[12], did="track"),
        SearchTraceFrame.model_validate(
            {"frame": 24, "time_us": sheet.timestamps_us[24], "did": "searched", "candidates": lines,
             "scores": [2.0, -1.0, None], "chosen": 1}
        ),
    )  # fmt: skip
    write_search_trace(found.directory, found.rows[0], frames)
    return found


def test_an_adversary_is_where_it_drove_with_what_it_considered(site: Site, tmp_path: Path) -> None:
    sheet = first_sheet(site)
    driven = [pursued(tmp_path / others, sheet, others=others) for others in ("replay", "idm")]
    files, index = build_drive_files(driven, site.sheets), build_drive_index(driven, site.sheets)
    index.sort(key=lambda one: EVERYBODY not in one["note"])
    assert [EVERYBODY in one["note"] for one in index] == [True, False]
    assert all(ADVERSARY in one["note"] for one in index)
    beside, alone = (value_of(files[f"data/scenes/{one['key']}.js"]) for one in index)
    assert "agents" not in beside and alone["agents"] == []
    moved, recorded = beside["moved"], sheet.agents[-1]
    assert moved == alone["moved"] and moved["adversary"] and moved["id"] == recorded.id
    assert moved["first"] == min(recorded.first, 12) and moved["count"] == 12 - moved["first"] + 17
    x = np.cumsum([*moved["x"], *[0] * (moved["count"] - len(moved["x"]))]) * 0.01
    assert x[-17:] == pytest.approx(5.0 + 0.1 * np.arange(17), abs=0.006)
    track, searched = beside["considered"]
    assert (track["did"], track["paths"], track["chosen"]) == ("track", [], None)
    # The worst is first, and the driven one is among them.
    assert searched["shares"] == [100, 100, 0] and searched["chosen"] == searched["paths"][-1]
    assert searched["t"] == pytest.approx((sheet.timestamps_us[24] - sheet.timestamps_us[0]) * 1e-6, abs=1e-3)


def test_the_page_plays_a_drive_with_what_an_adversary_considered_until_it_is_switched_off(
    site: Site, browser: Browser, tmp_path: Path
) -> None:
    sheet = first_sheet(site)
    driven = [drive_of(tmp_path / name, sheet, name) for name in ("replay", "idm")] + [pursued(tmp_path / "p", sheet)]
    start = write_site(read_results(site.records, sheets=site.sheets, drives=driven), tmp_path / "site")
    index = build_drive_index(driven, site.sheets)
    (replayed, answered, hunted) = (
        next(one["key"] for one in index if words in one["measured"])
        for words in ("agents replay", "agents idm", "agents adversary")
    )
    text = opened(browser, start, f"#/drive/{replayed}?t=2")
    assert re.search(r"contact at \d+\.\d s with", text) and EVERYBODY in text and "ego, as driven" in text
    assert "not judged" not in text and "Sample 5" in text and not browser.all("player-show-considered")
    assert "Only the ego is shown as driven" in opened(browser, start, f"#/drive/{answered}")
    scene = scene_key((sheet.data.name, sheet.split, sheet.scene))
    assert "Driven in closed loop" in opened(browser, start, f"#/scene/{scene}")
    text = opened(browser, start, f"#/drive/{hunted}?t=2.1")
    assert ADVERSARY in text and "what its search found" in text
    box = browser.one("player-show-considered")
    with_them = birdseye(browser)
    browser.click(box)
    without = birdseye(browser)
    browser.click(box)
    assert with_them != without and birdseye(browser) == with_them
    assert "the scene's own track" in opened(browser, start, f"#/drive/{hunted}?t=1.5")


def opened(browser: Browser, index: str, route: str) -> str:
    """What a page with a player says."""
    browser.open(route, start=index)
    browser.one("player-scrub")
    browser.frames()
    return str(browser.js("return document.querySelector('main').innerText"))


def windowed(folder: Path, sheet: ScenePage) -> DriveRecord:
    """A drive around an encounter with the sheet's last agent, which departs at 1.5 s."""
    window = {"of": sheet.scene, "start": 2, "end": 6, "adversaries": [sheet.agents[-1].id], "departs_s": 1.5}
    measured = {"engine": "default", "agents": "idm", "sensor": "none", "window": "encounter"}
    return drive_of(folder, sheet, measured=measured, window=window, ttc_s=[None, 1.5, 0.2])


def test_a_drive_around_an_encounter_opens_there_and_marks_the_adversary_from_its_departure(
    site: Site, tmp_path: Path
) -> None:
    sheet = first_sheet(site)
    driven = windowed(tmp_path, sheet)
    (said,) = build_drive_index([driven], site.sheets)
    assert "window encounter" in said["measured"] and "Orange is the adversary, from 1.5 s on" in said["note"]
    drive = value_of(build_drive_files([driven], site.sheets)[f"data/scenes/{said['key']}.js"])
    # Driving begins at 1 s; of the half seconds from there the first is without danger.
    assert drive["opens"] == pytest.approx(1.0)
    kinds = [kind for kind, *_ in drive["strip"]]
    assert kinds == ["ttc", "ttc", "touch cp-touch-adversary"] and "height:50%" in drive["strip"][0][1]
    assert "at 2.3 s touches the adversary, at fault: changed lane" in drive["strip"][2][2]
    before, after = drive["agents"]
    assert (before["id"], before["adversary"]) == (after["id"], False) and after["adversary"]
    assert before["first"] + before["count"] == after["first"]
    assert drive["frames"][after["first"]] == pytest.approx(1.5, abs=0.05)


def test_the_page_of_a_window_opens_there_with_its_strip(site: Site, browser: Browser, tmp_path: Path) -> None:
    driven = [windowed(tmp_path / "d", first_sheet(site))]
    start = write_site(read_results(site.records, sheets=site.sheets, drives=driven), tmp_path / "site")
    (entry,) = build_drive_index(driven, site.sheets)
    text = opened(browser, start, f"#/drive/{entry['key']}")
    assert "time to collision" in text and "the adversary, at fault" in text
    assert browser.one("player-time").text.startswith("1.0")
    bars = "return [...document.querySelectorAll('.cp-ttc')].map((bar) => bar.getBoundingClientRect().height);"
    low, high = browser.js(bars)
    assert high > low > 0.0
