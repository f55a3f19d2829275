"""Every line of code that README and docs/ tell a reader to type, and what becomes of it in the tests."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
TYPED: Final = (
    "challenger-bench",
    "make",
    "pip",
    "python",
    "ray",
    "cd",
    "echo",
    "bash",
    "./",
    "for",
    "uv",
    "docker",
    "ruff",
)
"""How a line begins that somebody types; blocks of other lines are what something prints."""

NOT_HERE: Final = (
    (r"cuda", "a GPU"),
    (r"(http|grpc)://", "a server that answers; tests/benchmark/extensions/http and alpasim have some"),
    (r"challenger-bench serve", "serves until it is stopped; tests/benchmark/extensions/http stops it"),
    (r"\.pth|weights fetch|vad-tiny|WEIGHTS|anchors\.safetensors", "published weights"),
    (r"--model (uniad|vad|sparsedrive|diffusiondrive)\b(?!-mini).*--data|uniad-unoptimised", "published weights"),
    (r"--as-published", "published weights"),
    (r"weights anchors", "a training split with thousands of samples"),
    (r"challenger-bench quality", "weights of DINO, MUSIQ and SAM 2"),
    (r"magicdrive", "weights of MagicDriveDiT"),
    (r"--golden DIR", "numbers of official code"),
    (r"--tables v1\.0-mini|/data/Adv-nuSc", "nuScenes itself"),
    (r"scenarionet RECORDINGS|from RECORDINGS|--to recordings", "recordings of others"),
    (r"challenger-bench eval .*--results (?!results\.pkl)", "result files of official code"),
    (r"scene-0553|--from edited", "a recording that somebody edited; tests/generation/splits edits one"),
    (r"--freeze generation/splits", "a checkout to change"),
    (r"sheets .*--rounds", "a search that kept its rounds; tests/benchmark/scene_pages has one"),
    (
        r"--data MINI|--data town|--root town|--checkpoint uniad-mini",
        "hours of training; tests/adapters/extensions/training has minutes of it",
    ),
    (r"--executor ray|^ray ", "a cluster; tests/benchmark/machine/test_ray_cluster.py has two nodes"),
    (r"^(pip|uv|echo|docker|make|for) ", "an index of packages, or a machine to change"),
    (r"^(cd|bash|\./tools|python tools)", "official code"),
    (r"import[- ]123d", "logs of others; tests/generation/extensions/logs123d makes some"),
    (r"data export mcap", "foxglove-sdk, and drives; tests/benchmark/extensions/mcap has some"),
    (r"--for sparsedrive", "pictures of 1600x900; tests/benchmark/extensions/infos draws some"),
    (
        r"data (pack|unpack|card) |leaderboard card",
        "a split and records of your own; the tests of these commands make some",
    ),
    (r"challenge (check|score)", "entries of others; tests/benchmark/extensions/challenge has some"),
    (r"--shard |--model MODEL|generate --data ROOT", "several jobs; tests/benchmark/runs/test_sharded.py gives them"),
    (r"data review (?!.*--(list|verdicts))", "somebody who looks at a page"),
    (r"--data challenged", "sessions of a simulator; tests/benchmark/extensions/alpasim/traffic makes some"),
    (r"--verdicts", "a file of verdicts; tests/benchmark/extensions/review has one"),
    (r"reproduce .*ROOT", "a file of expected values"),
    (r"my_package|--model vad-served", "a planner of your own"),
    (r"^python (bench/|-m (bench|tests))", "a checkout to change, or an hour of measuring"),
    (
        r"(--data|check|show|stats|make_root\.py) mine\b",
        "the root of an example; tests/benchmark/extensions/own_recordings makes it",
    ),
)
"""Lines that run nowhere in the tests, and what they need."""

LONGER: Final = (
    r"challenger-bench (generate|ablate|film|sheets|demo)(?!.*--dry-run)",
    r"challenger-bench eval .*(uniad|vad|sparsedrive|diffusiondrive)",
    r"--sensor schematic",
    r"--engine neuroncap|--agents adversary",
    r"--explain-protocols",
    r"challenger-bench data (stats|show|export|import|review)",
    r"my_planner",
    r"challenger-bench leaderboard",
    r"challenger-bench (transfer|failures)",
    r"my-adv-1\.json|boston-adv-1\.json",
    r"submit-check|--freeze|adv-seed-0",
    r"--data (/data/nuscenes|demo) --split adv",
)
"""Lines that `make docs` runs, not every test."""


@dataclass(frozen=True, slots=True)
class Line:
    """What a page tells a reader to type, comments removed and continued lines joined; lines count from 1."""

    page: Path
    number: int
    text: str

    @property
    def needs(self) -> str | None:
        """What it needs that is not here; ``None`` if it runs."""
        return next((needed for sign, needed in NOT_HERE if re.search(sign, self.text)), None)

    @property
    def takes_long(self) -> bool:
        """Whether it is left to `make docs`."""
        return any(re.search(sign, self.text) for sign in LONGER)


def typed_lines(page: Path) -> Iterator[Line]:
    """Every line that a page tells to type in a shell, in order."""
    text = page.read_text()
    for block in re.finditer(r"^```(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if block.group(1) not in ("", "sh", "console"):
            continue
        first = text[: block.start(2)].count("\n") + 1
        for place, line in enumerate(block.group(2).replace("\\\n", "  ").splitlines()):
            words = shlex.split(line, comments=True, posix=False) if line.startswith(TYPED) else []
            if words and words[0].startswith(TYPED) and not words[0].endswith(":"):
                yield Line(page, first + place, " ".join(words))
