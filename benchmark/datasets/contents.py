"""What a data set holds, in numbers."""

from collections import Counter
from typing import Any

from benchmark.datasets.roots import DataSet


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
