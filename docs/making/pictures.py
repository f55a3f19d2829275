"""README's film, picture of the site and table, made together from the embedded town's newest published split.

``python docs/making/pictures.py`` makes them anew in ``build/pictures`` (minutes, and Chromium), writes
``docs/images/made.json``, which says what they were made from, and puts the table into README.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from benchmark.cli.demo import describe_sources

ROOT: Final = Path(__file__).resolve().parents[2]
IMAGES: Final = ROOT / "docs" / "images"
MADE: Final = IMAGES / "made.json"
OUT: Final = ROOT / "build" / "pictures"
ALL: Final = "--split val --split adv"
TABLE: Final = f"eval {ALL} --model constant-velocity --model ego-status --model idm"
"""What README tells to type; its first table is README's."""
SCENE: Final = "scene-8027-dad2248c"
SHOWN: Final = "--format webp --width 960 --model constant-velocity --model ego-status --model idm"
FILM: Final = f"--scenes {SCENE} --from 12 --until 18 {SHOWN}"
WINDOW: Final = "1366,900"


def main() -> None:
    """Evaluate, film, draw the site, and write down what all of it was made from."""
    bench(f"eval {ALL} --model uniad-mini")
    table = first_table(bench(TABLE))
    bench("sheets --split val")
    bench("sheets --split adv")
    bench(f"film --split adv {FILM} --to {OUT / 'films'}")
    shutil.copyfile(OUT / "films" / f"{SCENE}.webp", IMAGES / "film.webp")
    bench("leaderboard")
    photograph(OUT / "leaderboard" / "site" / "index.html", IMAGES / "site.png")
    replace_table(table)
    MADE.write_text(json.dumps(describe_made(table), indent=1) + "\n")


def bench(line: str) -> str:
    """Run a command, and return what it prints."""
    command = [sys.executable, "-m", "benchmark", *line.split(), "--out", OUT]
    wide = {**os.environ, "COLUMNS": "100"}
    return subprocess.run(command, cwd=ROOT, env=wide, stdout=subprocess.PIPE, text=True, check=True).stdout


def first_table(printed: str) -> str:
    """The first table that a command printed, with its title and without its notes."""
    found = re.search(r"^.*: effect of the adversary.*\n(?:.+\n)+", printed, re.MULTILINE)
    if found is None:
        raise SystemExit(f"eval printed no table of the adversary's effect:\n{printed}")
    return found.group()


def photograph(page: Path, picture: Path) -> None:
    """The first screen of a page, as Chromium draws it."""
    options = ["--headless", "--no-sandbox", "--hide-scrollbars", "--virtual-time-budget=12000"]
    address = page.resolve().as_uri()
    subprocess.run(["chromium", *options, f"--window-size={WINDOW}", f"--screenshot={picture}", address], check=True)


def replace_table(table: str) -> None:
    """Put the table where README has the one of the last time."""
    readme = ROOT / "README.md"
    before: str = json.loads(MADE.read_text())["table"]
    readme.write_text(readme.read_text().replace(before, table))


def describe_made(table: str) -> dict[str, Any]:
    """What made.json says: the package's state, the table, the film's scene, and the pictures' hashes."""
    return {
        "command": f"challenger-bench {TABLE}",
        "table": table,
        "film": f"challenger-bench film --split adv {FILM}",
        "made from": describe_made_from(),
        "sha256": {name: hash_of(IMAGES / name) for name in ("film.webp", "site.png")},
    }


def describe_made_from() -> dict[str, Any]:
    """Split and weights, as the package has them now."""
    sources = describe_sources()
    return {name: sources[name] for name in ("frozen split", "weights", "town", "protocols")}


def hash_of(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


if __name__ == "__main__":
    main()
