"""One workspace, one site and one browser for all tests of the site; tests change copies alone."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from selenium.common.exceptions import WebDriverException

from benchmark.machine.storage import write_bytes
from benchmark.records.run import RunRecord, find_records
from benchmark.records.scene_pages import ScenePages, find_scene_pages
from leaderboard.build import write_leaderboard
from leaderboard.frame.results import LeaderboardResults, read_results
from leaderboard.page.sections import NamedFigure
from leaderboard.site.site import build_site_files
from tests.leaderboard.site.big_workspace import BigWorkspace, make_workspace
from tests.leaderboard.site.browser import HEIGHT_PX, WIDTH_PX, Browser, find_chromium, started

SCENES, MODELS, SAMPLES = 12, 4, 14
_SVG = b"<svg xmlns='http://www.w3.org/2000/svg' width='640' height='400'%s/>"
# A PNG of 640 x 400 pixels by its head alone: sizes of figures are read there.
_PNG = (
    b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + (640).to_bytes(4) + (400).to_bytes(4) + b"\x08\x02\x00\x00\x00" + bytes(4)
)
FIGURE = NamedFigure("rates-exact", "Rates", _PNG, _SVG % b"", lambda: _SVG % b" id='dark'")


@dataclass(frozen=True, slots=True)
class Site:
    """A written leaderboard with its site, and what it was made from; `index` is ``index.html``."""

    made: BigWorkspace
    records: tuple[RunRecord, ...]
    sheets: ScenePages
    index: Path

    @property
    def board(self) -> Path:
        """The leaderboard's folder."""
        return self.index.parents[1]


def write_site(results: LeaderboardResults, folder: Path) -> str:
    """Write the pages alone, without tables and figures; the address of ``index.html``."""
    for path, content in build_site_files(results, []).items():
        write_bytes(folder / path, content.read_bytes() if isinstance(content, Path) else content)
    return (folder / "index.html").as_uri()


@contextlib.contextmanager
def without_drawing() -> Iterator[None]:
    """Figures have tests of their own and take most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("leaderboard.figures.contents.RUN_FIGURES", (lambda frame: (FIGURE,),))
        for name in ("draw_heat_maps", "draw_lift_maps"):
            patch.setattr(f"leaderboard.figures.contents.{name}", lambda _: (_PNG, _SVG % b"", lambda: _SVG % b""))
        yield


@pytest.fixture
def no_drawing() -> Iterator[None]:
    with without_drawing():
        yield


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder = tmp_path_factory.mktemp("site")
    made = make_workspace(folder, SCENES, MODELS, samples=SAMPLES)
    records, sheets = find_records(folder / "runs"), find_scene_pages(folder / "sheets")
    with without_drawing():
        write_leaderboard(read_results(records, sheets=sheets), folder / "leaderboard")
    return Site(made, tuple(records), sheets, folder / "leaderboard" / "site" / "index.html")


@pytest.fixture(scope="session")
def _running(site: Site) -> Iterator[Browser]:
    found = find_chromium()
    if found is None:
        pytest.skip(
            "no Chromium with its driver here; make browser installs Debian's, or name them with CHROMIUM and "
            "CHROMEDRIVER"
        )
    with contextlib.ExitStack() as until_all_tests_ran:
        try:
            running = until_all_tests_ran.enter_context(started(found, site.index.as_uri()))
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
    # A scene that plays would go on through the tests of other modules.
    _running.driver.get("about:blank")
    assert left == [], "warnings or errors in the console"
