"""What a data set holds, in numbers."""

from collections import Counter
from typing import Any, Final

from benchmark.datasets.roots import DataSet
from benchmark.report.table import table_of
from benchmark.report.terminal import wrapped

_NAMES_SHOWN: Final = 24
"""Scene names that a terminal shows of a split."""


def contents(data: DataSet) -> dict[str, Any]:
    """Count a data set's content.

    Args:
        data: The data set.

    Returns:
        Name, version, fingerprint, what it was made from, and per split: scenes, samples, objects annotated at any
        sample and annotations.
    """
    provenance = data.provenance() or {}
    splits: dict[str, Any] = {}
    known: list[str | None] = [*sorted(data.splits())]
    for split in known or [None]:
        names = data.scene_names(split)
        counts = Counter[str]()
        for name in names:
            # One scene at a time: a whole data set of them does not fit into memory.
            scene = data.scene(name)
            counts["samples"] += len(scene.keyframes)
            counts["instances"] += int(scene.annotations.valid.any(axis=1).sum())
            counts["annotations"] += int(scene.annotations.valid.sum())
            counts["adversaries"] += len(scene.adversaries)
        totals = {kind: counts[kind] for kind in ("samples", "instances", "annotations", "adversaries")}
        splits[split or "all"] = {"scenes": list(names), **totals}
    return {
        "name": data.name,
        "root": str(data.root),
        "version": data.version,
        "fingerprint": data.fingerprint(),
        "made_from": provenance.get("source"),
        "splits": splits,
    }


def _some(names: list[str]) -> str:
    left_out = len(names) - _NAMES_SHOWN
    return ", ".join(names[:_NAMES_SHOWN]) + (f" and {left_out} more (--json names all)" if left_out > 0 else "")


def contents_text(found: dict[str, Any], width: int | None = None) -> str:
    """What `contents` found, for a terminal.

    Args:
        found: What it returned.
        width: Columns of the terminal, if it is not to be asked.

    Returns:
        Lines.
    """
    source = found["made_from"] if isinstance(found["made_from"], dict) else {}
    facts = [
        ("name", found["name"]),
        ("root", found["root"]),
        ("version", found["version"]),
        ("fingerprint", found["fingerprint"]),
        *(
            [("made from", f"{source.get('name', 'no name')} ({str(source.get('fingerprint'))[:12]}…)")]
            if source
            else []
        ),
    ]
    counts = ("samples", "instances", "annotations", "adversaries")
    rows = [
        (split, str(len(held["scenes"])), *(f"{held[kind]:,}" for kind in counts))
        for split, held in found["splits"].items()
    ]
    lines = [f"{f'{name}:':<13}{value}" for name, value in facts]
    names = [
        line
        for split, held in found["splits"].items()
        for line in wrapped(f"{split}: {_some(held['scenes'])}", width, hanging="  ")
    ]
    return "\n".join([*lines, "", table_of("", "", ("split", "scenes", *counts), rows).plain(width=width), *names, ""])
