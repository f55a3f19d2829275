"""What commands are given beside data sets: small files, made once, of which both trees read the same bytes."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final

_ADV = "split/data/town/adv"


def _rows(root: Path, table: str) -> list[dict[str, str]]:
    rows: list[dict[str, str]] = json.loads(next(root.glob(f"*/{table}.json")).read_text())
    return rows


def _rules(file: Path, work: Path) -> None:
    file.write_text("name = 'a challenge'\n[gaps]\nothers_m = 0.01\n")


def _verdicts(file: Path, work: Path) -> None:
    """The first scene stands, all others do not."""
    names = sorted(row["name"] for row in _rows(work / _ADV, "scene"))
    said = [{"verdict": "rejected" if index else "accepted", "reason": "looked at"} for index in range(len(names))]
    file.write_text(json.dumps(dict(zip(names, said, strict=True))))


def _plans(file: Path, work: Path) -> None:
    """Straight on at 6 m/s, for every sample."""
    header = ",".join(f"{axis}{step}" for step in range(1, 7) for axis in "xy")
    ahead = ",".join(f"{3.0 * step},0.0" for step in range(1, 7))
    rows = [f"{row['token']},ego,{ahead}\n" for row in _rows(work / "town", "sample")]
    file.write_text(f"sample_token,frame,{header}\n{''.join(rows)}")


def _expected(file: Path, work: Path) -> None:
    said = {
        "model": "uniad-mini",
        "protocol": "uniad",
        "split": "val",
        "source": "made up",
        "values": {"l2": {"1s": 1.0, "3s": 2.0}, "collision": {"avg": 2.0}},
        "allowed": {"l2": 0.5, "collision": 1.0},
        "samples": 60,
    }
    file.write_text(json.dumps(said))


def _networks(file: Path, work: Path) -> None:
    from tests.benchmark.extensions.quality.small_networks import save_small_networks

    save_small_networks(file)


def _magicdrive(file: Path, work: Path) -> None:
    shutil.copytree(Path(__file__).parents[2] / "tests/golden/parity/magicdrive", file)


def _irt(file: Path, work: Path) -> None:
    shutil.copytree(Path(__file__).parents[2] / "tests/golden/irt", file)


INPUTS: Final[dict[str, Callable[[Path, Path], None]]] = {
    "rules.toml": _rules,
    "verdicts.json": _verdicts,
    "plans.csv": _plans,
    "expected.json": _expected,
    "networks": _networks,
    "magicdrive": _magicdrive,
    "irt": _irt,
}
"""By name: what writes the file or folder, given where, and the work folder of the start's tree."""
