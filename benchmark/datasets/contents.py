"""Content of a data set, in numbers."""

from typing import Any, Final

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.report.table import build_table
from benchmark.report.terminal import wrap_text

_NAMES_SHOWN: Final = 24
"""Scene names that a terminal shows of a split."""
_KINDS: Final = ("samples", "instances", "annotations", "adversaries")


def contents(data: DataSet) -> dict[str, Any]:
    """Count a data set's content.

    Args:
        data: The data set.

    Returns:
        Name, version, fingerprint, what it was made from, per split that can be evaluated scenes, samples, objects
        annotated at any sample and annotations, and why other splits cannot be.
    """
    provenance = data.provenance() or {}
    usable, unusable = list_scenes_by_split(data)
    scenes = {
        name: _count_scene(data, name) for name in dict.fromkeys(name for names in usable.values() for name in names)
    }
    splits = {
        split: {"scenes": list(names), **{kind: sum(scenes[name][kind] for name in names) for kind in _KINDS}}
        for split, names in usable.items()
    }
    return {
        "name": data.name,
        "root": str(data.root),
        "version": data.version,
        "fingerprint": data.fingerprint(),
        "made_from": provenance.get("source"),
        "splits": splits,
        "unusable_splits": unusable,
    }


def list_scenes_by_split(data: DataSet) -> tuple[dict[str, tuple[str, ...]], dict[str, str]]:
    """Scene names of each split that can be evaluated, and a sentence for each of the others why it cannot be."""
    usable: dict[str, tuple[str, ...]] = {}
    unusable: dict[str, str] = {}
    for split in data.split_names():
        try:
            names = data.scene_names(split)
        except InputError as error:
            unusable[split] = str(error)
            continue
        if names:
            usable[split] = names
        else:
            unusable[split] = f"inspectors rejected all of its scenes (challenger-bench data review {data.root})"
    return usable, unusable


def _count_scene(data: DataSet, name: str) -> dict[str, int]:
    """Counts of one scene; one is in memory at a time, for a whole data set of them does not fit."""
    scene = data.scene(name)
    is_annotated = scene.annotations.valid
    numbers = (len(scene.keyframes), is_annotated.any(axis=1).sum(), is_annotated.sum(), len(scene.adversaries))
    return dict(zip(_KINDS, map(int, numbers), strict=True))


def _shorten_list(names: list[str]) -> str:
    left_out = len(names) - _NAMES_SHOWN
    return ", ".join(names[:_NAMES_SHOWN]) + (f" and {left_out} more (--json names all)" if left_out > 0 else "")


def format_contents(found: dict[str, Any], width: int | None = None) -> str:
    """Text of the result of `contents` for a terminal of some width; without a width, the terminal is asked."""
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
    rows = [
        (split, str(len(scene_names["scenes"])), *(f"{scene_names[kind]:,}" for kind in _KINDS))
        for split, scene_names in found["splits"].items()
    ]
    lines = [f"{f'{name}:':<13}{value}" for name, value in facts]
    names = [
        line
        for split, scene_names in found["splits"].items()
        for line in wrap_text(f"{split}: {_shorten_list(scene_names['scenes'])}", width, hanging="  ")
    ]
    left_out = [
        line
        for split, why in found["unusable_splits"].items()
        for line in wrap_text(f"{split} cannot be evaluated: {why}", width, hanging="  ")
    ]
    table = build_table("", "", ("split", "scenes", *_KINDS), rows).plain(width=width)
    return "\n".join([*lines, "", table, *names, *left_out, ""])
