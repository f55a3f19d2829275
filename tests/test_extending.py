"""The package of examples/extension, installed from outside: each kind works, and removing it leaves nothing behind."""

import json
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import cv2
import pytest

from benchmark.machine.extension import OFFERS

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "extension"
RUN = """
import contextlib, io, json, sys
from benchmark.cli.app import main
from benchmark.machine.extension import OFFERS, list_offers

said = []
for line in json.loads(sys.argv[1]):
    sys.argv = ["challenger-bench", *line]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            main()
        except SystemExit as ended:
            code = ended.code
    said.append({"code": code, "out": out.getvalue(), "err": err.getvalue()})
print(json.dumps([{kind: list(list_offers(kind)) for kind in OFFERS}, said]))
"""


@dataclass(frozen=True)
class Said:
    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Environment:
    """A virtual environment that sees the packages of this one, and a folder to work in."""

    python: Path
    work: Path

    def pip(self, *arguments: str | Path) -> None:
        quiet = ("--disable-pip-version-check", "--quiet")
        command = [sys.executable, "-m", "pip", "--python", str(self.python), *quiet, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    def run(self, lines: dict[str, str]) -> tuple[dict[str, list[str]], dict[str, Said]]:
        """Run command lines one after the other in one process; what is on offer there, and what each line said."""
        words = json.dumps([line.split() for line in lines.values()])
        command = [str(self.python), "-c", RUN, words]
        done = subprocess.run(command, cwd=self.work, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        offers, said = json.loads(done.stdout)
        return offers, {name: Said(**one) for name, one in zip(lines, said, strict=True)}


HELP = {"help": "--help", **{f"help {name}": f"{name} --help" for name in ("eval", "drive", "generate")}}
SMALL = "--data town --out out --workers 1"
WRITTEN = "eval --data town --workers 1 --model easing --json"
FIRST = {
    **HELP,
    "build": "data build --root town --town-scenes 1 --frames keyframes --size 96x54 --workers 1",
    "renderer": f"generate {SMALL} --split val-r --renderer outline --outline-px 2 --frames keyframes --size 96x54",
    "judge": f"eval {SMALL} --model easing --easing-m-s2 2 --model constant-velocity --protocol margin --json",
    "set": f"{WRITTEN} --out set --set easing_m_s2=3",
    "config": f"{WRITTEN} --out config --config easing.yaml",
    "engine": f"drive {SMALL} --split val --model constant-velocity --engine overshoot --no-baselines --json",
    "default engine": f"drive {SMALL} --split val --model constant-velocity --no-baselines --json",
    "command": "margins --out out",
    "exporter": "data export csv town --to csv --out out",
    "leaderboard": "leaderboard --out out",
    "unused": f"eval {SMALL} --model constant-velocity --easing-m-s2 2",
}
AFTER = {
    **HELP,
    "renderer": f"generate {SMALL} --split val-r --renderer outline",
    "option": f"generate {SMALL} --split val-r --outline-px 2",
    "judge": f"eval {SMALL} --model stop --protocol margin",
    "planner": f"eval {SMALL} --model easing",
    "engine": f"drive {SMALL} --split val --model stop --engine overshoot",
    "command": "margins --out out",
    "exporter": "data export csv town --to csv",
    "leaderboard": "leaderboard --out out",
    "rescore": "rescore --data town --out out",
}


@dataclass(frozen=True)
class Tried:
    work: Path
    offers: dict[str, list[str]]
    said: dict[str, Said]
    files: dict[str, str]
    offers_after: dict[str, list[str]]
    after: dict[str, Said]


def text_files(folder: Path) -> dict[str, str]:
    kinds = (".md", ".html", ".json", ".js")
    return {p.relative_to(folder).as_posix(): p.read_text() for p in folder.rglob("*") if p.suffix in kinds}


@pytest.fixture(scope="module")
def tried(tmp_path_factory: pytest.TempPathFactory) -> Tried:
    """Everything that was said with the package installed, and after it was removed."""
    work = tmp_path_factory.mktemp("extending")
    environment = Environment(work / "venv" / "bin" / "python", work)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", work / "venv"], check=True)
    (own,) = (work / "venv" / "lib").glob("python*/site-packages")
    (own / "of_the_tests.pth").write_text(f"{ROOT}\n{sysconfig.get_path('purelib')}\n")
    before = sorted(own.iterdir())
    # A copy, since an editable installation writes beside the code.
    shutil.copytree(EXAMPLE, work / "package", ignore=shutil.ignore_patterns("*.egg-info", "__pycache__"))
    environment.pip("install", "--no-index", "--no-deps", "--no-build-isolation", "-e", work / "package")
    (work / "easing.yaml").write_text("easing_m_s2: 3.0\n")
    offers, said = environment.run(FIRST)
    files = text_files(work / "out" / "leaderboard")
    environment.pip("uninstall", "--yes", "challenger-margins")
    assert sorted(path for path in own.iterdir() if path.name != "__pycache__") == before
    return Tried(work, offers, said, files, *environment.run(AFTER))


def test_all_that_the_package_offers_works(tried: Tried) -> None:
    codes = {name: one.code for name, one in tried.said.items() if one.code != 0}
    assert codes == {"unused": 2}, {name: tried.said[name].err for name in codes}
    assert "--easing-m-s2 is only for the planner easing" in tried.said["unused"].err
    own: dict[str, dict[str, str]] = {}
    exec((EXAMPLE / "challenger_margins" / "__init__.py").read_text(), own)
    assert tried.offers == {kind: [*offered, *own["OFFERS"].get(kind, ())] for kind, offered in OFFERS.items()}


def test_help_has_its_commands_choices_and_options_in_its_panel(tried: Tried) -> None:
    assert re.search(r"^  margins +Print the near misses", tried.said["help"].out, re.MULTILINE)
    for name, option in (("eval", "--easing-m-s2"), ("drive", "--easing-m-s2"), ("generate", "--outline-px")):
        (panel,) = re.findall(r"^margins:\n((?:  .*\n)+)", tried.said[f"help {name}"].out, re.MULTILINE)
        assert option in panel
    assert "|overshoot>" in tried.said["help drive"].out and "|outline>" in tried.said["help generate"].out


def test_a_judge_and_a_planner_stand_in_the_record(tried: Tried) -> None:
    easing, constant = json.loads(tried.said["judge"].out)
    assert [run["status"] for run in (easing, constant)] == ["complete", "complete"]
    for run in (easing, constant):
        rates = {name: run["protocols"][name]["columns"]["collision"]["3s"]["value"] for name in ("exact", "margin")}
        assert rates["margin"] >= rates["exact"]
        stored = json.loads((tried.work / run["directory"] / "run.json").read_text())
        assert stored["protocols"]["margin"] == 1
    stored = json.loads((tried.work / easing["directory"] / "run.json").read_text())
    assert stored["planner"]["settings"]["easing_m_s2"] == 2.0


@pytest.mark.parametrize("way", ["set", "config"])
def test_an_option_may_be_set_or_stand_in_a_file(tried: Tried, way: str) -> None:
    (run,) = json.loads(tried.said[way].out)
    stored = json.loads((tried.work / run["directory"] / "run.json").read_text())
    assert stored["planner"]["settings"]["easing_m_s2"] == 3.0


def test_an_engine_drives_otherwise_than_the_default_one(tried: Tried) -> None:
    rows = {}
    for name in ("engine", "default engine"):
        (record,) = json.loads(tried.said[name].out)
        lines = (tried.work / record["directory"] / "drives.jsonl").read_text().splitlines()
        rows[name] = [json.loads(line) for line in lines]
        assert record["measured"]["engine"] == ("overshoot" if name == "engine" else "default")
        assert all(row["status"] == "ok" for row in rows[name])
    assert [row["ticks"] for row in rows["engine"]] != [row["ticks"] for row in rows["default engine"]]


def test_a_renderer_drew_the_data_set(tried: Tried) -> None:
    root = tried.work / "out" / "data" / "town" / "val-r"
    facts = json.loads((root / "v1.0-trainval" / "challenger.json").read_text())
    assert (facts["renderer"]["name"], facts["renderer"]["version"]) == ("outline", "1, 2 px")
    pictures = [cv2.imread(str(path)) for path in root.glob("samples/CAM_FRONT/*.jpg")]
    assert any(picture.min() < 128 for picture in pictures) and all(picture.mean() > 200 for picture in pictures)


def test_an_exporter_wrote_a_file_a_scene(tried: Tried) -> None:
    (file,) = (tried.work / "csv").glob("*.csv")
    head, *rows = file.read_text().splitlines()
    assert head == "time_us,id,category,x,y,yaw" and len(rows) > 40
    assert "of 3" in tried.said["command"].out


def test_tables_and_site_have_its_table_and_page(tried: Tried) -> None:
    assert "plans too close to others (%)" in tried.files["README.md"]
    assert "<li>easing on val: " in tried.files["site/pages/margins.html"]
    assert '"path":"pages/margins.html","tab":"protocols"' in tried.files["site/data/index.js"]


def test_removed_it_leaves_nothing_behind(tried: Tried) -> None:
    assert tried.offers_after == {kind: [*offered] for kind, offered in OFFERS.items()}
    for name in HELP:
        assert not re.search("margin|easing|outline|overshoot", tried.after[name].out + tried.after[name].err), name


@pytest.mark.parametrize("name", ["renderer", "option", "judge", "planner", "engine", "command", "exporter"])
def test_removed_its_names_are_refused_in_one_sentence(tried: Tried, name: str) -> None:
    one = tried.after[name]
    assert one.code == 2 and "Traceback" not in one.err
    assert one.err.count("\n") == 1 and one.err.startswith("error: "), one.err


def test_removed_the_records_it_judged_and_drove_are_still_shown(tried: Tried) -> None:
    assert tried.after["leaderboard"].code == 0, tried.after["leaderboard"].err
    files = text_files(tried.work / "out" / "leaderboard")
    assert "site/pages/margins.html" not in files and "pages/margins" not in files["site/data/index.js"]
    assert "easing" in files["README.md"] and "engine overshoot" in files["README.md"]
    assert "judged by protocol margin, of an extension that is not installed here" in files["README.md"]
    assert "Engine overshoot: of an extension that is not installed here." in files["README.md"]


def test_removed_rescore_keeps_its_verdicts(tried: Tried) -> None:
    said = tried.after["rescore"]
    assert said.code != 0 and "holds verdicts of margin, which is not installed" in said.out + said.err
    stored = [json.loads(path.read_text()) for path in tried.work.glob("out/runs/**/run.json")]
    assert [run["protocols"]["margin"] for run in stored] == [1, 1]


def blocks(page: Path) -> list[str]:
    return re.findall(r"^```(?:python|toml)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)


def test_the_code_of_the_page_is_that_of_the_package() -> None:
    files = [*(EXAMPLE / "challenger_margins").glob("*.py"), EXAMPLE / "pyproject.toml"]
    texts = [path.read_text() for path in files]
    shown = blocks(ROOT / "docs" / "extending.md")
    assert len(shown) >= 8
    for block in shown:
        # Dots stand for what is left out.
        parts = [part for part in re.split(r"(?:^ *|: )\.\.\.\n", block, flags=re.MULTILINE) if part.strip()]
        assert any(all(part in text for part in parts) for text in texts), block


def test_the_wheel_has_nothing_of_the_example() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]["find"]
    for name in ("examples", "examples.extension", "challenger_margins"):
        assert not any(fnmatchcase(name, pattern) for pattern in settings["include"]), name
