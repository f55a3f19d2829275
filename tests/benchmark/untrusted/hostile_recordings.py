"""Hostile ScenarioNet files: one value of a valid recording is another, or there is more than roads have."""

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.benchmark.untrusted.variants import Variant

Recording = dict[str, Any]


def _with(place: str, value: Any) -> Callable[[bytes], bytes]:
    def change(valid: bytes) -> bytes:
        held = pickle.loads(valid)  # noqa: S301 - made by this test
        *parents, last = place.split("/")
        inner = held
        for parent in parents:
            inner = inner[parent]
        inner[last] = value
        return pickle.dumps(held)

    return change


def _after(change: Callable[[Recording], None]) -> Callable[[bytes], bytes]:
    def changed(valid: bytes) -> bytes:
        held: Recording = pickle.loads(valid)  # noqa: S301 - made by this test
        change(held)
        return pickle.dumps(held)

    return changed


def _scribble(points: int) -> Any:
    line = np.random.default_rng(0).uniform(-400, -100, (points, 3))
    line[-1] = line[0]
    return line


def _gap(held: Recording) -> None:
    held["metadata"]["ts"] = np.concatenate([np.arange(30) * 0.1, [1e9]])


def _endless(held: Recording) -> None:
    held["length"], held["metadata"]["ts"] = 1_000_000, np.arange(1_000_000) * 0.1


def _ring(held: Recording) -> None:
    held["map_features"]["boundary_0"] = {"type": "ROAD_LINE", "polyline": _scribble(20_000)}


def _thicket(held: Recording) -> None:
    lane = held["map_features"]["a"]
    for number in range(3000):
        across = np.array([[-400.0, np.sin(number) * 200, 0], [-200.0, np.cos(number) * 200, 0]])
        held["map_features"][f"lane {number}"] = {**lane, "polyline": across}


def _links(held: Recording) -> None:
    names = [str(number) for number in range(3000)]
    for name in names:
        held["map_features"][name] = {**held["map_features"]["a"], "exit_lanes": names}


def _crowd(held: Recording) -> None:
    held["tracks"] |= {f"copy {number}": held["tracks"]["1"] for number in range(20_000)}


def _two_of_one_name(held: Recording) -> None:
    held["tracks"][0] = held["tracks"]["0"]


STATE = "tracks/1/state"
RECORDINGS = tuple(
    Variant("scenarionet", name, change)
    for name, change in {
        "tracks that are a list": _with("tracks", [1]),
        "a track that is nothing": _with("tracks/1", None),
        "a state that is an array": _with(STATE, np.zeros(3)),
        "a type that is an array": _with("tracks/1/type", np.zeros(3)),
        "positions that are text": _with(f"{STATE}/position", ["a"] * 31),
        "positions that are complex": _with(f"{STATE}/position", np.zeros((31, 3), complex)),
        "positions of uneven length": _with(f"{STATE}/position", [[1.0], [2.0, 3.0]]),
        "positions beyond the earth": _with(f"{STATE}/position", np.full((31, 3), 1e308)),
        "headings that are nothing": _with(f"{STATE}/heading", None),
        "a length that is an array": _with("length", np.zeros(31)),
        "times with a gap of thirty years": _after(_gap),
        "a million steps": _after(_endless),
        "an ego that is a list": _with("metadata/sdc_id", [1]),
        "an ego with a name of 10^5 letters": _with("metadata/sdc_id", "x" * 100_000),
        "an id that is an array": _with("id", np.zeros(3)),
        "an id of two lines": _with("id", "a\n../.."),
        "a source that is a dictionary": _with("metadata/dataset", {}),
        "a map feature that is a list": _with("map_features/a", []),
        "a width of uneven rows": _with("map_features/a/width", [[1], [2, 3]]),
        "neighbours that are lists": _with("map_features/a/exit_lanes", [[1]]),
        "a line beyond the earth": _with("map_features/a/polyline", np.array([[1e300, 0], [-1e300, 5]])),
        "a scribble of 20,000 points": _with("map_features/zebra/polygon", _scribble(20_000)),
        "a ring that is a scribble": _after(_ring),
        "lanes all across one another": _after(_thicket),
        "nine million links": _after(_links),
        "twenty thousand tracks": _after(_crowd),
        "two tracks with the same name": _after(_two_of_one_name),
    }.items()
) + tuple(
    Variant("scenarionet", name, change, harmless=True)
    for name, change in {
        "a location that is an array": _with("metadata/map", np.zeros(3)),
        "a category that is an array": _with("tracks/1/metadata/type", np.zeros(3)),
        "a width beyond the earth": _with("map_features/a/width", np.full((3, 2), 1e308)),
        "a crossing that is nothing": _with("map_features/zebra/polygon", None),
    }.items()
)
