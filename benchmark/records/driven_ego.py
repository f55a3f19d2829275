"""Reports of generation on a scene: for an ego that a planner drove, the path of a good driver from there.

A planner that learned from good drivers alone never saw the places that its own driving leads it to. In scenes of
``data build --driven`` the ego goes where a record of drives says that it went. Its own future is nothing to learn
from; the way back to what the town's driver would have done is (Ross et al. 2011, DAgger).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.planning import Command


def read_scene_report(provenance: Mapping[str, Any] | None, scene: str, name: str, otherwise: object = None) -> object:
    """One part of the report of a scene in ``challenger.json``, unchecked; ``otherwise`` where nothing is said."""
    scene_entry = (provenance or {}).get("scenes", {}).get(scene, {})
    report = scene_entry.get("report") if isinstance(scene_entry, Mapping) else None
    return report.get(name, otherwise) if isinstance(report, Mapping) else otherwise


DRIVEN: Final = "driven"
"""Where the report of a scene (``challenger.json``) says it."""
_FURTHEST_M: Final = 1e6
_AGAIN: Final = "build the data again"


@dataclass(frozen=True, slots=True)
class DrivenEgoTargets:
    """Targets for learning from a scene that a planner drove.

    ``wanted`` are (K, 6, 2) global positions of the lidar origin at the plan's steps from each; NaN where there is
    none.
    """

    planner: str
    commands: tuple[Command, ...]
    wanted: Floats

    @property
    def known(self) -> Bools:
        """(K, 6) whether a position is there."""
        return np.asarray(np.isfinite(self.wanted).all(-1))

    def as_json(self) -> dict[str, Any]:
        """Plain values for a report; millimetres."""
        places = [
            [
                [round(float(value), 3) for value in place] if is_known else None
                for place, is_known in zip(*command, strict=True)
            ]
            for command in zip(self.wanted, self.known, strict=True)
        ]
        return {"planner": self.planner, "commands": [int(command) for command in self.commands], "wanted": places}

    @classmethod
    def from_json(cls, value: object) -> Self:
        """Read what `as_json` wrote."""
        if not isinstance(value, Mapping) or not isinstance(value.get("planner"), str):
            raise InputError(f"a driven scene must name its planner; {_AGAIN}")
        commands, wanted = value.get("commands"), value.get("wanted")
        if not isinstance(commands, list) or not isinstance(wanted, list) or len(commands) != len(wanted):
            raise InputError(f"a driven scene must have a command and a path for each key frame; {_AGAIN}")
        known = {int(item) for item in Command}
        if any(type(item) is not int or item not in known for item in commands):
            raise InputError(f"the commands of a driven scene must be 0, 1 or 2; {_AGAIN}")
        return cls(value["planner"], tuple(map(Command, commands)), np.array([_read_path(item) for item in wanted]))


def _read_path(places: object) -> Floats:
    if not isinstance(places, Sequence) or len(places) != PLAN_STEPS:
        raise InputError(f"each path of a driven scene must have {PLAN_STEPS} points; {_AGAIN}")
    path = np.full((PLAN_STEPS, 2), np.nan)
    for row, place in enumerate(places):
        if place is None:
            continue
        if not isinstance(place, list) or len(place) != 2 or not all(_is_place(coordinate) for coordinate in place):
            raise InputError(f"a point of a driven scene must be two numbers or null; {_AGAIN}")
        path[row] = place
    return path


def _is_place(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _FURTHEST_M


def read_driven_ego_targets(provenance: Mapping[str, Any] | None, scene: str) -> DrivenEgoTargets | None:
    """Targets for learning from a scene, by ``challenger.json``; ``None`` where the ego was not driven by a planner."""
    stored = read_scene_report(provenance, scene, DRIVEN)
    return None if stored is None else DrivenEgoTargets.from_json(stored)
