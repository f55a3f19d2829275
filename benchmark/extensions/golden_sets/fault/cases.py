"""Cases of fault attribution as JSON: tracks of two users, a map or none, and whose fault it is and why."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np
from shapely.affinity import affine_transform
from shapely.geometry import Polygon

from benchmark.fairness.fault_definition import (
    ContactTracks,
    FaultAttribution,
    FaultReason,
    FaultVerdict,
    RoadUser,
)
from benchmark.fairness.fault_roads import FaultRoads, RoadLane
from benchmark.fairness.fault_rules import attribute_fault
from benchmark.geometry import Floats
from benchmark.road_map import Handedness
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder

FORMAT: Final = "fault-1"
LAYERS: Final = ("drivable_area", "walkways", "crossings", "carparks")
"""Surfaces of a map, as in its file and as arguments of `FaultRoads`."""


@dataclass(frozen=True, slots=True)
class FaultCase:
    """One case; ``lanes`` is ``None`` without a map.

    Attributes:
        surfaces: Polygons by layer.
        stop_lines: With their types.
        why: Reason for the verdict, in a sentence.
    """

    name: str
    why: str
    handedness: Handedness
    tracks: ContactTracks
    lanes: tuple[RoadLane, ...] | None
    surfaces: Mapping[str, tuple[Polygon, ...]]
    stop_lines: tuple[tuple[Polygon, str | None], ...]
    verdict: FaultVerdict
    reason: FaultReason

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """A case from the values of its file."""
        users, stored = facts["users"], facts["map"]
        times = np.asarray(users["ego"]["times_s"], np.float64)
        ego, other = (_read_user(users[name], times) for name in ("ego", "other"))
        layers = stored or {}
        return cls(
            name=facts["name"],
            why=facts["why"],
            handedness=Handedness(facts["handedness"]),
            tracks=ContactTracks(times, ego, other),
            lanes=None if stored is None else tuple(map(_read_lane, stored["lanes"])),
            surfaces={name: tuple(map(_read_polygon, layers.get(name, ()))) for name in LAYERS},
            stop_lines=tuple((_read_polygon(line["polygon"]), line["type"]) for line in layers.get("stop_lines", ())),
            verdict=FaultVerdict(facts["expected"]["verdict"]),
            reason=FaultReason(facts["expected"]["reason"]),
        )

    def roads(self) -> FaultRoads | None:
        """Its map."""
        if self.lanes is None:
            return None
        return FaultRoads(self.lanes, **self.surfaces, stop_lines=self.stop_lines)

    def attribute(self) -> FaultAttribution:
        """What we say of it."""
        return attribute_fault(self.tracks, self.roads(), self.handedness)

    def exchanged(self) -> Self:
        """Ego and other exchanged, and so the verdict."""
        return replace(
            self,
            tracks=ContactTracks(self.tracks.times_s, self.tracks.other, self.tracks.ego),
            verdict=EXCHANGED.get(self.verdict, self.verdict),
        )

    def turned(self, angle_rad: float, offset_m: tuple[float, float]) -> Self:
        """All of it turned about the origin, then moved."""
        cos, sin = float(np.cos(angle_rad)), float(np.sin(angle_rad))
        return self._moved(np.array([[cos, -sin], [sin, cos]]), np.array(offset_m), lambda yaw: yaw + angle_rad)

    def mirrored(self) -> Self:
        """All of it mirrored, with the other handedness."""
        handed = Handedness.LEFT if self.handedness is Handedness.RIGHT else Handedness.RIGHT
        mirrored = self._moved(np.array([[1.0, 0.0], [0.0, -1.0]]), np.zeros(2), lambda yaw: -yaw)
        return replace(mirrored, handedness=handed)

    def _moved(self, matrix: Floats, offset: Floats, turn: Callable[[Floats], Floats]) -> Self:
        def place(points: Floats) -> Floats:
            return np.asarray(points @ matrix.T + offset)

        def move(shape: Polygon) -> Polygon:
            return affine_transform(shape, [*matrix.ravel(), *offset])

        def drive(user: RoadUser) -> RoadUser:
            return replace(user, pose=np.column_stack([place(user.pose[:, :2]), turn(user.pose[:, 2])]))

        lanes = None
        if self.lanes is not None:
            lanes = tuple(
                replace(
                    lane,
                    centerline=place(lane.centerline),
                    polygon=None if lane.polygon is None else move(lane.polygon),
                )
                for lane in self.lanes
            )
        tracks = ContactTracks(self.tracks.times_s, drive(self.tracks.ego), drive(self.tracks.other))
        return replace(
            self,
            tracks=tracks,
            lanes=lanes,
            surfaces={name: tuple(map(move, shapes)) for name, shapes in self.surfaces.items()},
            stop_lines=tuple((move(shape), kind) for shape, kind in self.stop_lines),
        )


EXCHANGED: Final = {FaultVerdict.EGO: FaultVerdict.OTHER, FaultVerdict.OTHER: FaultVerdict.EGO}
VARIANTS: Final[tuple[tuple[str, Callable[[FaultCase], FaultCase]], ...]] = (
    ("as given", lambda case: case),
    ("exchanged", FaultCase.exchanged),
    ("turned and moved", lambda case: case.turned(0.7, (-350.0, 120.0))),
    ("mirrored", FaultCase.mirrored),
)


def read_cases(folder: GoldenFolder) -> list[FaultCase]:
    """The cases of a set, in the order of its manifest, whose verdicts must be theirs."""
    manifest = folder.facts("manifest.json")
    if manifest["format"] != FORMAT:
        raise ValueError(f"its format is {manifest['format']!r}, not {FORMAT!r}")
    cases = []
    for listed in manifest["cases"]:
        case = FaultCase.of(folder.facts(f"{listed['name']}.json"))
        if (case.name, case.verdict, case.reason) != (listed["name"], listed["verdict"], listed["reason"]):
            raise ValueError(f"the manifest says something else of case {listed['name']} than its file")
        cases.append(case)
    return cases


def compare_cases(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare verdict and reason of every case, as given and in variants."""
    for case in read_cases(folder):
        here = comparison.at(case.name)
        for variant, change in VARIANTS:
            changed = change(case)
            ours = changed.attribute()
            here.verdicts(f"verdict, {variant}", ours.verdict is not changed.verdict)
            here.verdicts(f"reason, {variant}", ours.reason is not changed.reason)


def _read_user(user: Mapping[str, Any], times_s: Floats) -> RoadUser:
    if not np.array_equal(np.asarray(user["times_s"], np.float64), times_s):
        raise ValueError("both users must have the same times")
    pose = np.column_stack([np.asarray(user[name], np.float64) for name in ("x_m", "y_m", "yaw_rad")])
    speed = np.asarray(user["speed_m_s"], np.float64)
    return RoadUser(str(user["class"]), float(user["length_m"]), float(user["width_m"]), pose, speed)


def _read_lane(lane: Mapping[str, Any]) -> RoadLane:
    return RoadLane(
        str(lane["id"]),
        np.asarray(lane["centerline"], np.float64).reshape(-1, 2),
        None if lane["polygon"] is None else _read_polygon(lane["polygon"]),
        float(lane["width_m"]),
        tuple(map(str, lane["successors"])),
        bool(lane["junction"]),
    )


def _read_polygon(rings: Sequence[Sequence[Sequence[float]]]) -> Polygon:
    return Polygon(rings[0], rings[1:])
