"""Labels of an ego that was driven off its path: when it left the path, and how it came back.

A recording of good drivers never shows how to come back to the path. In scenes of ``data build --off-path`` the ego
departs from the path that it would have driven, and comes back. Departing is nothing to learn from; coming back is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Self

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.records.driven_ego import read_scene_report

OFF_PATH: Final = "off_path"
"""Where the report of a scene (``challenger.json``) names its excursions."""


@dataclass(frozen=True, slots=True)
class Excursion:
    """One departure from the path and the way back; times in seconds from the start of the scene.

    ``kind`` is what was wrong at ``worst_s``, when the ego begins to come back: ``lateral``, ``heading``, ``fast``,
    ``slow`` or ``late-braking``. Deviations are those at that time, against the undisturbed drive: offset to the left,
    heading counter-clockwise.
    """

    kind: str
    begin_s: float
    worst_s: float
    end_s: float
    lateral_m: float
    heading_rad: float
    ahead_m: float
    faster_mps: float

    def as_json(self) -> dict[str, Any]:
        """Plain values for a report."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: object) -> Self:
        """Read what `as_json` wrote; times that do not follow one another are refused."""
        numbers = [name for name in cls.__dataclass_fields__ if name != "kind"]
        if (
            not isinstance(value, Mapping)
            or not isinstance(value.get("kind"), str)
            or not all(isinstance(value.get(name), int | float) for name in numbers)
        ):
            raise InputError(
                f"an excursion off the path must have a kind and {', '.join(numbers)}; build the data again"
            )
        excursion = cls(kind=str(value["kind"]), **{name: float(value[name]) for name in numbers})
        if not 0 <= excursion.begin_s < excursion.worst_s < excursion.end_s < np.inf:
            raise InputError("the times of an excursion off the path must increase; build the data again")
        return excursion


def read_excursions(provenance: Mapping[str, Any] | None, scene: str) -> tuple[Excursion, ...]:
    """Excursions of a scene's ego in order of time, by ``challenger.json``; none where it kept to its path."""
    entries = read_scene_report(provenance, scene, OFF_PATH, [])
    if not isinstance(entries, list):
        raise InputError(f"{OFF_PATH} of scene {scene} must be a list of excursions; build the data again")
    return tuple(Excursion.from_json(entry) for entry in entries)


def find_followable_positions(excursions: Sequence[Excursion], now_s: Floats, later_s: Floats) -> Bools:
    """(...) False where the ego departs from its path between two times: positions there are nothing to learn from.

    Seconds from the start of the scene: ``now_s`` of the plan, and ``later_s`` of the position, not before it.
    """
    now, later = np.broadcast_arrays(now_s, later_s)
    good = np.ones(now.shape, dtype=np.bool_)
    for excursion in excursions:
        good &= (later <= excursion.begin_s) | (now >= excursion.worst_s)
    return good
