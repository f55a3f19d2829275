"""The first page in words: what this is, the scene that plays, and where to go on."""

from collections.abc import Mapping, Sequence
from typing import Any

from benchmark.records.run import RunRecord
from benchmark.report.words import pluralise
from leaderboard.site.scene_words import address, count_marks

_WORDS = {
    "table": "Every protocol, transfer between planners, causes, what protocols miss and invent.",
    "planner": "Rates under every protocol, why it collides, its worst scenes, what exactly ran.",
    "scene": "By manoeuvre, by who fails and who does not; each plays, with all plans.",
    "attempt": "Vehicles that the search tried as adversaries, and why most were discarded.",
}
_PAGES = {"table": "tables", "planner": "models", "scene": "scenes", "attempt": "attempts"}


def build_starts(index: Mapping[str, Any], records: Sequence[RunRecord]) -> list[dict[str, Any]]:
    """First page of each data set: ``data``, ``lead``, ``scene`` (key of the one that plays), ``onwards`` (links)."""
    scenes = index["scenes"]
    names = dict.fromkeys(each["data"] for each in (*index["keyTables"], *scenes))
    plain = {record.planner for record in records if not record.run.planner.privileged}
    for scene in scenes:
        scene["pair"] = _find_pair(index, scene)
    return [
        {
            "data": name,
            "lead": _describe(index, [scene for scene in scenes if scene["data"] == name]),
            "scene": (telling := _find_telling_scene(index, name, plain)) and telling["key"],
            "onwards": _list_links(index, name, telling),
        }
        for name in names
    ]


def _find_marks(index: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, str]:
    """Marks of planners under the first protocol, in the order of tables."""
    marks, protocol = scene["marks"], (*index["protocols"], "exact")[0]
    return {
        model["name"]: marks[model["name"]].get(protocol, "-") for model in index["models"] if model["name"] in marks
    }


def _find_pair(index: Mapping[str, Any], scene: Mapping[str, Any]) -> list[str]:
    """Two planners to compare: one that fails and one that does not, where there are such."""
    marks = _find_marks(index, scene)
    first = next((name for name, mark in marks.items() if mark in "xX"), next(iter(marks), None))
    others = [name for name in marks if name != first]
    second = next((name for name in others if marks[name] in "ao"), next(iter(others), None))
    return [name for name in (first, second) if name is not None]


def _find_telling_scene(index: Mapping[str, Any], data: str, plain: set[str]) -> dict[str, Any] | None:
    """The scene with a sheet on which plain planners differ most; adversarial ones first."""

    def rank(scene: Mapping[str, Any]) -> tuple[bool, int, int]:
        marks = _find_marks(index, scene).items()
        bad, split = count_marks(mark for name, mark in marks if name in plain or not plain)
        return bool(scene["manoeuvre"]), split, bad

    there = [scene for scene in index["scenes"] if scene["data"] == data and scene["thumb"]]
    return max(there, key=rank, default=None)


def _describe(index: Mapping[str, Any], scenes: Sequence[Mapping[str, Any]]) -> str:
    adversarial = sum(bool(scene["manoeuvre"]) for scene in scenes)
    of_them = f", {adversarial} of them adversarial" if adversarial else ""
    return (
        "challenger-bench tests end-to-end driving models on driving scenes in which one other car was made to drive "
        "adversarially: it cuts in, brakes, squeezes or tailgates. Every half second a planner says where it wants to "
        "drive for the next 3 s, and what is counted is how often that would hit something, under named protocols that "
        f"never share a column. Here are {pluralise(len(index['models']), 'planner')} on "
        f"{pluralise(len(scenes), 'scene')}{of_them}: every number with its interval, every scene to play."
    )


def _list_links(index: Mapping[str, Any], data: str, telling: Mapping[str, Any] | None) -> list[list[str]]:
    """Address, title and words of each link."""
    scenes = index["scenes"]
    here = {"data": data} if len({scene["data"] for scene in scenes}) > 1 else {}
    links = []
    for noun, page in _PAGES.items():
        count = sum(noun in ("planner", "attempt") or each["data"] in (data, "") for each in index[page])
        links += [[address(page, **here), pluralise(count, noun), _WORDS[noun]]] if count or noun != "attempt" else []
    compared = telling or next((each for each in scenes if each["data"] == data and len(each["marks"]) > 1), None)
    if compared is not None and len(compared["pair"]) > 1:
        first, second = compared["pair"]
        where = "the scene above" if telling else compared["scene"]
        link = address("compare", compared["key"], a=first, b=second)
        links.append([link, "Two side by side", f"{first} and {second} on {where}, moment by moment."])
    return links
