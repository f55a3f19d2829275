"""What the site opens with, in words: what this is, what the splits are, and the scene that plays."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from benchmark.records.run import RunRecord
from benchmark.records.run_schema import is_baseline
from benchmark.report.words import pluralise
from leaderboard.site.scene_words import address, count_marks

_SPLITS: Final = {
    "val": "recorded scenes as they are",
    "val-r": "the same, rendered anew",
    "adv": "the same recordings with one vehicle that drives adversarially",
}


def build_starts(index: Mapping[str, Any], records: Sequence[RunRecord]) -> list[dict[str, Any]]:
    """First page of each data set: ``data``, ``lead``, ``splits``, ``scene`` (key of the one that plays), ``compare``.

    The last is the address of two planners on that scene and what it shows, or null.
    """
    scenes = index["scenes"]
    names = dict.fromkeys(each["data"] for each in (*index["mainTables"], *scenes))
    plain = {record.planner for record in records if not is_baseline(record.run.planner)}
    for scene in scenes:
        scene["pair"] = _find_pair(_find_marks(index, scene), plain)
    starts = []
    for name in names:
        own = [scene for scene in scenes if scene["data"] == name]
        telling = _find_telling_scene(index, own, plain)
        starts.append(
            {
                "data": name,
                "lead": _describe(len(index["models"]), own),
                "splits": _describe_splits({scene["split"] for scene in own}),
                "scene": telling and telling["key"],
                "compare": telling and _link_pair(telling),
            }
        )
    return starts


def _find_marks(index: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, str]:
    """Marks of planners under the first protocol, in the order of tables."""
    marks, protocol = scene["marks"], (*index["protocols"], "exact")[0]
    return {
        model["name"]: marks[model["name"]].get(protocol, "-") for model in index["models"] if model["name"] in marks
    }


def _find_pair(marks: Mapping[str, str], plain: set[str]) -> list[str]:
    """Two planners to compare, no baselines where there are others: one that fails and one that does not."""
    names = sorted(marks, key=lambda name: name not in plain)
    first = next((name for name in names if marks[name] in "xX" and name in plain), next(iter(names), None))
    others = [name for name in names if name != first]
    second = next((name for name in others if marks[name] in "ao"), next(iter(others), None))
    return [name for name in (first, second) if name is not None]


def _find_telling_scene(
    index: Mapping[str, Any], scenes: Sequence[dict[str, Any]], plain: set[str]
) -> dict[str, Any] | None:
    """The scene with a sheet on which planners, without baselines, differ most; adversarial ones first."""

    def rank(scene: Mapping[str, Any]) -> tuple[bool, int, int]:
        marks = _find_marks(index, scene).items()
        bad, split = count_marks(mark for name, mark in marks if name in plain or not plain)
        return bool(scene["manoeuvre"]), split, bad

    return max((scene for scene in scenes if scene["thumb"]), key=rank, default=None)


def _describe(planners: int, scenes: Sequence[Mapping[str, Any]]) -> str:
    adversarial = sum(bool(scene["manoeuvre"]) for scene in scenes)
    of_them = f", {adversarial} of them adversarial" if adversarial else ""
    return (
        "How often do the plans of driving models, 3 s ahead, hit something on recorded scenes, and how often when one "
        f"other vehicle drives adversarially? {pluralise(planners, 'planner')} on "
        f"{pluralise(len(scenes), 'scene')}{of_them}."
    )


def _describe_splits(splits: set[str]) -> str:
    known = [f"{split}: {words}" for split, words in _SPLITS.items() if split in splits]
    order = " Rows: by the paired difference, least first." if {"val", "adv"} <= splits else ""
    return f"{'; '.join(known)}.{order}" if known else ""


def _link_pair(scene: Mapping[str, Any]) -> list[str] | None:
    if len(scene["pair"]) < 2:
        return None
    first, second = scene["pair"]
    return [address("compare", scene["key"], a=first, b=second), f"{first} and {second} side by side"]
