"""Which run records there are, from their ``run.json`` alone: for sentences that say what there is instead."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.machine.storage import read_kept_json
from benchmark.records.store import RUN_FILE


@dataclass(frozen=True, slots=True, order=True)
class Recorded:
    """What one record is of.

    Attributes:
        data: Name of the data set.
        split: The split.
        planner: Name of the planner.
    """

    data: str
    split: str
    planner: str


def recorded(folders: Iterable[Path]) -> tuple[Recorded, ...]:
    """What the records below folders are of.

    Args:
        folders: Where to look; they need not exist.

    Returns:
        Sorted, each once; what is damaged is left out, reading the record itself says so.
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


def said_of(found: Iterable[Recorded]) -> str:
    """What there is, in words: ``there are records of demo (adv: idm; val: idm)``, or that there are none."""
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
