"""What README and docs/ tell a reader to type does what the page says: it runs here, on a tiny town.

Lines that take long run with ``make docs`` (``CHALLENGER_BENCH_LONG_LINES=1``), and some nowhere: `NOT_HERE` says
what they need. Blocks with ``>>>`` are examples of their own (tests/benchmark/test_python_face.py).
"""

import json
import os
import re
import shlex
import shutil
from functools import partial
from pathlib import Path

import pytest
import typer

import benchmark
from benchmark.cli.app import app
from generation.sources.mini import TownSettings, build_town_data_set
from generation.splits.packaged import NamedSplit, read_newest_split
from tests.documentation.lines_of_code import LONGER, NOT_HERE, PAGES, ROOT, Line, typed_lines
from tests.whole_product import ABSENT

LONG = bool(os.environ.get("CHALLENGER_BENCH_LONG_LINES"))
LINES = [line for page in PAGES for line in typed_lines(page)]
RUN = [line for line in LINES if line.needs is None and line.text.startswith("challenger-bench ")]
BEFORE = {
    "films.md": [
        "eval --split adv --model vad-mini --model idm --model uniad",
        "drive --split adv --model vad-mini --sensor schematic",
    ],
    "alpasim_score.md": ["drive --split val --model constant-velocity --no-baselines"],
    "cards.md": ["eval --split val --model constant-velocity"],
    "challenge.md": ["eval --split val --model constant-velocity"],
    "publishing.md": ["eval --split adv --model constant-velocity", "leaderboard"],
    "site.md": ["eval --split adv --model constant-velocity"],
    "sheets.md": ["eval --split adv --model constant-velocity"],
    "quality.md": ["eval --split adv --model constant-velocity"],
    "submissions.md": ["eval --data ROOT --split val --model constant-velocity"],
}
"""What a page takes for granted: the reader gave these commands before."""
MADE = {"README.md": "demo", "exchange.md": "mini", "infos.md": "nuscenes"}
"""Data set whose splits a page finds below challenger-out, because the reader made them before."""
FIRST = min(read_newest_split("mini").frozen.scenes, key=lambda scene: scene.name)
PLACES = {
    "ROOT": "town",
    "/data/nuscenes": "town",
    "/data/for-uniad": "for-uniad",
    "/data/for-vad": "for-vad",
    "/data/for-sparsedrive": "for-sparsedrive",
    "NEW": "new",
    "NAME": FIRST.name,
}
"""What a page calls its reader's places and scenes, and what they are called here."""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache of its own and a town, for all pages."""
    folder = tmp_path_factory.mktemp("tiny")
    build_town_data_set(folder / "town", TownSettings(val_scenes=1, width=96, height=54, frames="keyframes"), workers=1)
    return folder


@pytest.fixture
def desk(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder where a reader sits, with what pages speak of: a data set, a demo, a planner."""
    whole, first = read_newest_split("mini"), FIRST
    count = int(first.source[-4:]) - 7999
    small = partial(TownSettings, val_scenes=count, width=96, height=54, frames="keyframes")
    few = NamedSplit(whole.name, whole.frozen.model_copy(update={"scenes": (first,)}))
    monkeypatch.setattr("generation.sources.mini.TownSettings", small)
    monkeypatch.setattr("generation.splits.cached.read_newest_split", lambda *_: few)
    for place in ("benchmark.api", "benchmark.api.opening", "benchmark.api.planners"):
        monkeypatch.setattr(f"{place}.worker_count", lambda _: 1)
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tiny / "cache"))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    shutil.copytree(tiny / "town", "town")
    planner = re.search(r"```python\n# my_planner\.py\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert planner is not None
    Path("my_planner.py").write_text(planner.group(1))
    return tmp_path


def command(text: str) -> list[str]:
    """Arguments of a line, with places of this desk for those of the page."""
    for place, here in PLACES.items():
        text = re.sub(rf"(?<![\w/-]){re.escape(place)}(?![\w-])", here, text)
    return [word for word in shlex.split(text)[1:] if word != "..."]


def runs(text: str) -> None:
    """Run a line here; a page promises exit code 0."""
    code = typer.main.get_command(app).main(command(text), prog_name="challenger-bench", standalone_mode=False)
    assert code in (None, 0), f"exit code {code}"


def prepare(page: Path) -> None:
    """Do what a page takes for granted."""
    if page.name in MADE:
        mini, made = benchmark.open_data("mini"), Path("challenger-out/data", MADE[page.name])
        shutil.copytree("town", made / "val")
        shutil.copytree(benchmark.open_split(mini, "adv").root, made / "adv")
    if page.name == "README.md":
        runs("challenger-bench eval --data demo --split adv --model constant-velocity --dump-results uniad")
        (dumped,) = Path("challenger-out").rglob("results.pkl")
        shutil.copy(dumped, "results.pkl")
        write_plans(Path("plans.csv"))
    for line in BEFORE.get(page.name, []):
        runs(f"challenger-bench {line}")


def write_plans(path: Path) -> None:
    """A plan file for the demo's adversarial split: standing still."""
    table = json.loads(next(Path("challenger-out/data/demo/adv").glob("v1.0-*/sample.json")).read_text())
    columns = [f"{axis}{step}" for step in range(1, 7) for axis in "xy"]
    rows = [",".join([row["token"], "ego", *["0"] * len(columns)]) for row in table]
    path.write_text("\n".join([",".join(["sample_token", "frame", *columns]), *rows]) + "\n")


def name(line: Line) -> str:
    return f"{line.page.name}:{line.number}"


@pytest.mark.parametrize("page", sorted({line.page for line in RUN}), ids=lambda page: page.name)
def test_the_lines_of_a_page_run_in_their_order(page: Path, desk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = [line for line in RUN if line.page == page and (LONG or not line.takes_long)]
    if not lines:
        pytest.skip("all its lines take long: make docs runs them")
    if LONG:
        prepare(page)
    for line in lines:
        # Several roots are exported to folders of one name, which is refused; a reader takes one of them.
        for exported in Path().glob("for-*") if page.name == "infos.md" else ():
            shutil.rmtree(exported)
        try:
            runs(line.text)
        except Exception as error:
            if "no adversarial scene survived" in str(error):
                pytest.skip(f"{name(line)}: the search finds nothing in so small a town; the lines before it ran")
            if ABSENT and "which is not installed" in str(error):
                continue
            error.add_note(f"{name(line)}: {line.text}")
            raise


def test_every_line_runs_or_says_what_it_needs() -> None:
    assert len(LINES) > 100
    left = [f"{name(line)}: {line.text}" for line in LINES if line.needs is None and line not in RUN]
    assert not left, "neither a command of ours nor in NOT_HERE"


def test_every_reason_belongs_to_a_line() -> None:
    for sign, needed in NOT_HERE:
        assert any(re.search(sign, line.text) for line in LINES), f"{sign} ({needed}) is on no page"
    for sign in LONGER:
        assert any(re.search(sign, line.text) and line.needs is None for line in LINES), f"{sign} is on no page"


def test_every_target_of_make_that_a_page_names_is_one() -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for line in LINES:
        if line.text.startswith("make "):
            named = [word for word in line.text.split()[1:] if "=" not in word]
            assert set(named) <= targets, name(line)
