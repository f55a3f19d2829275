"""One site and one browser for all tests of the site."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from selenium.common.exceptions import WebDriverException

from benchmark.records.run import RunRecord, find_records
from benchmark.records.scene_pages import ScenePages, find_scene_pages
from leaderboard.build import write_leaderboard
from leaderboard.frame.results import read_results
from tests.leaderboard.site.big_workspace import BigWorkspace, make_workspace
from tests.leaderboard.site.browser import HEIGHT_PX, WIDTH_PX, Browser, find_chromium, started

SCENES, MODELS, SAMPLES = 12, 4, 14


@dataclass(frozen=True, slots=True)
class Site:
    """A written site and what it was made from.

    Attributes:
        made: The workspace.
        records: Its run records.
        sheets: Its sheets.
        index: ``index.html``.
    """

    made: BigWorkspace
    records: tuple[RunRecord, ...]
    sheets: ScenePages
    index: Path


@pytest.fixture(scope="session")
def chromium() -> tuple[Path, Path]:
    found = find_chromium()
    if found is None:
        pytest.skip(
            "no Chromium with its driver here; make browser installs Debian's, or name them with CHROMIUM and "
            "CHROMEDRIVER"
        )
    return found


@pytest.fixture(scope="session")
def site(chromium: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder = tmp_path_factory.mktemp("site")
    made = make_workspace(folder, SCENES, MODELS, samples=SAMPLES)
    records, sheets = find_records(folder / "runs"), find_scene_pages(folder / "sheets")
    write_leaderboard(read_results(records, sheets=sheets), folder / "leaderboard")
    return Site(made, tuple(records), sheets, folder / "leaderboard" / "site" / "index.html")


@pytest.fixture(scope="session")
def _running(chromium: tuple[Path, Path], site: Site) -> Iterator[Browser]:
    with contextlib.ExitStack() as until_all_tests_ran:
        try:
            running = until_all_tests_ran.enter_context(started(chromium, site.index.as_uri()))
        except WebDriverException as error:
            said = (error.msg or "no reason given").splitlines()[0]
            pytest.skip(f"Chromium does not start on this machine: {said}")
        yield running


@pytest.fixture
def browser(_running: Browser) -> Iterator[Browser]:
    """The browser as a first visitor has it; whatever a test does, nothing may be left in the console."""
    _running.resize(WIDTH_PX, HEIGHT_PX)
    _running.prefer(None)
    _running.forget_logs()
    yield _running
    left = list(_running.note_logs())
    assert left == [], "warnings or errors in the console"
