"""What a data set holds, in numbers."""

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
        scenes = [data.scene(name) for name in names]
        splits[split or "all"] = {
            "scenes": list(names),
            "samples": sum(len(scene.keyframes) for scene in scenes),
            "instances": sum(int(scene.annotations.valid.any(axis=1).sum()) for scene in scenes),
            "annotations": sum(int(scene.annotations.valid.sum()) for scene in scenes),
            "adversaries": sum(len(scene.adversaries) for scene in scenes),
        }
    return {
        "name": data.name,
        "root": str(data.root),
        "version": data.version,
        "fingerprint": data.fingerprint(),
        "made_from": provenance.get("source"),
        "splits": splits,
    }
