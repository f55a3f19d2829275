"""Which run records there are, from their ``run.json`` alone: for sentences that say what there is instead."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.machine.storage import read_kept_json
from benchmark.records.store import ROWS_FILE, RUN_FILE


@dataclass(frozen=True, slots=True, order=True)
class Recorded:
    """Data set, split and planner of one record."""

    data: str
    split: str
    planner: str


def recorded(folders: Iterable[Path]) -> tuple[Recorded, ...]:
    """Data, split and planner of each record below folders, sorted, each once; the folders need not exist.

    A damaged record is left out: reading it says so.
    """
    found = set()
    for folder in folders:
        for path in folder.rglob(RUN_FILE):
            stored: Any = read_kept_json(path)
            try:
                found.add(Recorded(stored["data"]["name"], stored["split"], stored["planner"]["name"]))
            except (KeyError, TypeError):
                continue
    return tuple(sorted(found))


def where_planned(folders: Iterable[Path], samples: Sequence[tuple[str, ...]]) -> Recorded | None:
    """The first record that has some samples: what a plan file of other data seems to be for.

    Args:
        samples: Names of each sample in the rows of records: its token, or its scene and time.
    """
    for folder in folders:
        for path in sorted(folder.rglob(ROWS_FILE)):
            with path.open(encoding="utf-8", errors="replace") as lines:
                if any(all(part in line for part in each) for line in lines for each in samples):
                    return next(iter(recorded([path.parent])), None)
    return None


def said_of(found: Iterable[Recorded]) -> str:
    """Records in words: ``there are records of demo (adv: idm; val: idm)``, or that there are none."""
    places: dict[str, dict[str, list[str]]] = {}
    for each in found:
        places.setdefault(each.data, {}).setdefault(each.split, []).append(each.planner)
    if not places:
        return "there are no run records"
    named = []
    for data, splits in places.items():
        ran = "; ".join(f"{split}: {', '.join(planners)}" for split, planners in splits.items())
        named.append(f"{data} ({ran})")
    return f"there are records of {', '.join(named)}"
