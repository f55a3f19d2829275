"""AlpaSim's own tables of made-up policies, and files of results that it refuses."""

import csv
import io
import json
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.extensions.alpasim_table.subjects import read_subject, read_subjects
from benchmark.extensions.alpasim_table.table import (
    MANIFEST,
    MATRIX,
    RANKING,
    Anchors,
    Posterior,
    build_alpasim_table,
)
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet

TOLERANCE: Final = 1e-9
_NUMBERS: Final = ("_score", "_std", "offset", "scale", "_quantile", "_fault")
"""How names of numbers that are computed end; all else is equal."""


def compare_tables(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare the files of every case."""
    for place in folder.named("*/expected"):
        case, here = place.parent, comparison.at(place.parent.name)
        manifest = GoldenFolder(place).facts(MANIFEST)
        posterior, anchors = case / "posterior_given.json", case / "reference_manifest.json"
        table = build_alpasim_table(
            read_subjects(case / "runs"),
            manifest["requested_algorithm"],
            Posterior.read(posterior) if posterior.is_file() else None,
            Anchors.read(anchors) if anchors.is_file() else None,
        )
        _compare(here, "manifest", json.loads(table.files[MANIFEST]), manifest)
        for name in (MATRIX, RANKING):
            ours, golden = _read_rows(table.files[name]), _read_rows((place / name).read_bytes())
            here.verdicts(f"{name}: columns and rows", [*map(list, ours)] != [*map(list, golden)])
            for row, theirs in zip(ours, golden, strict=False):
                _compare(here, name, row, theirs)


def compare_refusals(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare which files are refused."""
    for name in folder.facts("expected.json"):
        comparison.verdicts("refused files", not _is_refused(folder.path / name), where=name)


def _is_refused(folder: Path) -> bool:
    path = folder / "aggregate" / "results-summary.json"
    if not path.is_file():
        raise ValueError(f"no {path}")
    try:
        read_subject(path, folder.name, str(path))
    except InputError:
        return True
    return False


def _compare(here: Comparison, name: str, ours: Any, golden: Any) -> None:
    """Compare values: numbers that are computed within the tolerance, all else exactly."""
    for key in sorted({*ours, *golden}):
        one, other = ours.get(key), golden.get(key)
        if isinstance(one, dict) and isinstance(other, dict):
            _compare(here, f"{name}: {key}", one, other)
        elif key.endswith(_NUMBERS) and one not in ("", None) and other not in ("", None):
            here.numbers(f"{name}: {key}", float(one), float(other))
        else:
            here.verdicts(f"{name}: {'scenes' if key.startswith('scene-') else key}", one != other)


def _read_rows(data: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(data.decode())))


GOLDEN: Final = GoldenSet(
    name="ability alpasim",
    files=("*/expected/manifest.json",),
    compare=(compare_tables,),
    quantities={"*": TOLERANCE},
    usual="alpasim",
    holds="tables of AlpaSim",
)
REFUSED: Final = GoldenSet(
    name="ability alpasim-refused", files=("expected.json",), compare=(compare_refusals,), usual="alpasim-refused"
)
