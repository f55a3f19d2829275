"""A scene as an OpenSCENARIO file: every object on its own trajectory in the plane, without a road network.

Needs ``scenariogeneration`` (extra ``openscenario``). Positions are global. The ego has its reference point at the rear
axle, as OpenSCENARIO asks; all else, whose axles are unknown, at the centre of its box on the ground.
"""

import datetime
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import (
    EGO_BODY_WIDTH_M,
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_HEIGHT_M,
    EGO_LENGTH_M,
    EGO_WHEELBASE_M,
    VERSION,
)
from benchmark.datasets.roots import DataSet
from benchmark.datasets.scenario_map import DATASET, NEEDS_A_PACKAGE, ExchangedScene
from benchmark.errors import InputError
from benchmark.extensions.exchange.exporting import ExportedScene, export_scenes, read_exchange_scene, scene_file
from benchmark.geometry import Bools, Floats
from benchmark.machine.storage import lock_folder, write_bytes
from benchmark.scene import Scene

EGO: Final = "ego"
ADVERSARY: Final = "adversary"
"""Property of an entity, ``true`` or ``false``; the header's property ``adversaries`` names them all."""
MINOR_VERSION: Final = 2
"""OpenSCENARIO 1.2: what players read."""
_VEHICLES: Final = {
    "truck": "truck", "bus": "bus", "trailer": "trailer", "construction": "truck", "bicycle": "bicycle",
    "motorcycle": "motorbike", "emergency": "van",
}  # fmt: skip
_PEDESTRIANS: Final = {"wheelchair": "wheelchair"}
_MOST_SPEED, _MOST_ACCELERATION, _MOST_BRAKING = 70.0, 10.0, 10.0
"""Limits that the format requires of vehicles; they constrain nothing here."""
_MASS_KG: Final = 70.0
_AXLE_SHARE: Final = 0.3
"""Axles of vehicles other than the ego lie so much of their length before and behind the centre: a guess."""


def export_openscenario(dataset: DataSet, names: Sequence[str], to: Path, *, workers: int) -> tuple[ExportedScene, ...]:
    """Write scenes as OpenSCENARIO files.

    Args:
        dataset: The data set.
        names: Its scenes.
        to: Folder; gets a file a scene, ``SCENE.xosc``.
        workers: Number of processes; the bytes are the same with any.

    Returns:
        The written files.

    Raises:
        InputError: If the package ``scenariogeneration`` is absent, a scene is broken, or the folder holds other
            scenarios or cannot be written.
    """
    require_package()
    with lock_folder(to):
        return tuple(export_scenes(names, to, "xosc", partial(_write, dataset, to), workers=workers))


def require_package() -> Any:
    """``scenariogeneration.xosc``; raises `InputError` where it is not installed."""
    try:
        from scenariogeneration import xosc
    except ImportError as error:
        raise InputError(NEEDS_A_PACKAGE) from error
    return xosc


def _write(dataset: DataSet, to: Path, name: str) -> ExportedScene:
    exchanged = read_exchange_scene(dataset, name)
    path = scene_file(to, name, "xosc")
    write_bytes(path, encode_openscenario(exchanged))
    return ExportedScene(path, exchanged.scene.name, exchanged.scene.adversaries)


def encode_openscenario(made: ExchangedScene) -> bytes:
    """A scene as OpenSCENARIO, the same bytes for the same scene.

    Objects follow polylines with absolute seconds of their frames. One that is not there at first is deleted in
    ``Init`` and added when it comes; it is deleted where it goes.
    """
    xosc, scene = require_package(), made.scene
    entities, init, act = xosc.Entities(), xosc.Init(), xosc.Act("tracks", _build_time_trigger(xosc, 0.0), None)
    for track in _tracks(scene):
        entities.add_scenario_object(track.name, track.entity(xosc))
        track.begin(xosc, init)
        act.add_maneuver_group(track.maneuvers(xosc))
    storyboard = xosc.StoryBoard(init, _build_time_trigger(xosc, float(scene.seconds[-1]), trigger="stop"))
    story = xosc.Story(scene.name)
    story.add_act(act)
    storyboard.add_story(story)
    header = xosc.Properties()
    for name, value in _describe_scene(made).items():
        header.add_property(name, value)
    scenario = xosc.Scenario(
        scene.name,
        f"{DATASET} {VERSION}",
        xosc.ParameterDeclarations(),
        entities,
        storyboard,
        xosc.RoadNetwork(),
        xosc.Catalog(),
        osc_minor_version=MINOR_VERSION,
        creation_date=_date(scene.date),
        header_properties=header,
    )
    element = scenario.get_element()
    ElementTree.indent(element)
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + bytes(ElementTree.tostring(element, encoding="utf-8")) + b"\n"


def _describe_scene(exchanged: ExchangedScene) -> dict[str, str]:
    """Description of the scene for the header."""
    return {
        "scene": exchanged.scene.name,
        "source_scene": exchanged.source_scene,
        "adversaries": " ".join(exchanged.scene.adversaries),
        "location": exchanged.scene.road_map.location,
        "first_frame_us": str(int(exchanged.scene.timestamps_us[0])),
    }


def _date(text: str) -> datetime.datetime:
    """When it was recorded: a file that was written later has the same bytes."""
    try:
        return datetime.datetime.fromisoformat(text)
    except ValueError:
        return datetime.datetime(1970, 1, 1)  # noqa: DTZ001 - the format has local times


def _tracks(scene: Scene) -> Iterator["_OpenScenarioTrack"]:
    ego = EGO
    while ego in scene.agents.ids:
        ego = f"{ego}_"
    size = np.array([EGO_LENGTH_M, EGO_BODY_WIDTH_M, EGO_HEIGHT_M])
    always = np.ones(len(scene.timestamps_us), np.bool_)
    yield _OpenScenarioTrack(
        ego, "vehicle.car", size, scene.ego.position, scene.ego.yaw, always, scene.seconds, is_ego=True
    )
    agents = scene.agents
    for row, name in enumerate(agents.ids):
        ground = agents.position[row] - [0.0, 0.0, 0.5 * agents.size[row, 2]]
        track = _OpenScenarioTrack(
            name, agents.categories[row], agents.size[row], ground, agents.yaw[row], agents.valid[row], scene.seconds
        )
        track.adversary = name in scene.adversaries
        yield track


class _OpenScenarioTrack:
    """One object as OpenSCENARIO has it: an entity, and what happens with it."""

    def __init__(
        self,
        name: str,
        category: str,
        size: Floats,
        ground: Floats,
        yaw: Floats,
        valid: Bools,
        seconds: Floats,
        *,
        is_ego: bool = False,
    ) -> None:
        self.name, self.category, self.size, self.adversary, self.is_ego = name, category, size, False, is_ego
        self._ground, self._yaw, self._valid, self._seconds = ground, yaw, valid, seconds

    def entity(self, xosc: Any) -> Any:
        """Vehicle, pedestrian or thing, with its box."""
        length, width, height = map(float, self.size)
        ahead = EGO_CENTER_FROM_REAR_AXLE_M if self.is_ego else 0.0
        box = xosc.BoundingBox(width, length, height, ahead, 0.0, 0.5 * height)
        kind, _, detail = self.category.partition(".")
        if kind == "vehicle":
            entity = self._vehicle(xosc, box, _VEHICLES.get(detail.partition(".")[0], "car"))
        elif kind in ("human", "animal"):
            called = "animal" if kind == "animal" else _PEDESTRIANS.get(detail.rpartition(".")[2], "pedestrian")
            category = getattr(xosc.PedestrianCategory, called)
            entity = xosc.Pedestrian(self.category, _MASS_KG, category, box)
        else:
            barrier = detail == "barrier"
            category = xosc.MiscObjectCategory.barrier if barrier else xosc.MiscObjectCategory.obstacle
            entity = xosc.MiscObject(self.category, _MASS_KG, category, box)
        entity.add_property(ADVERSARY, str(self.adversary).lower())
        entity.add_property("category", self.category)
        return entity

    def _vehicle(self, xosc: Any, box: Any, called: str) -> Any:
        length, width, height = map(float, self.size)
        front = EGO_WHEELBASE_M if self.is_ego else _AXLE_SHARE * length
        rear = 0.0 if self.is_ego else -_AXLE_SHARE * length
        wheel = min(0.7, 0.5 * height)
        axles = [xosc.Axle(0.5, wheel, 0.9 * width, axle_x, 0.5 * wheel) for axle_x in (front, rear)]
        category = getattr(xosc.VehicleCategory, called)
        return xosc.Vehicle(self.category, category, box, *axles, _MOST_SPEED, _MOST_ACCELERATION, _MOST_BRAKING)

    def begin(self, xosc: Any, init: Any) -> None:
        """Where it is at first, if it is there."""
        if self._valid[0]:
            init.add_init_action(self.name, xosc.TeleportAction(self._place(xosc, 0)))
        else:
            init.add_global_action(xosc.DeleteEntityAction(self.name))

    def maneuvers(self, xosc: Any) -> Any:
        """Maneuvers of an object: for each stretch of time that it is there it comes, follows its track, and goes."""
        maneuver = xosc.Maneuver(f"{self.name} maneuver")
        for number, (first, last) in enumerate(find_stretches(self._valid)):
            if first > 0:
                self._event(
                    xosc, maneuver, f"comes {number}", first, xosc.AddEntityAction(self.name, self._place(xosc, first))
                )
            if last > first:
                self._event(xosc, maneuver, f"drives {number}", first, self._trajectory(xosc, number, first, last))
            if last + 1 < len(self._valid):
                self._event(xosc, maneuver, f"goes {number}", last + 1, xosc.DeleteEntityAction(self.name))
        group = xosc.ManeuverGroup(f"{self.name} group")
        group.add_actor(self.name)
        group.add_maneuver(maneuver)
        return group

    def _event(self, xosc: Any, maneuver: Any, called: str, frame: int, action: Any) -> None:
        name = f"{self.name} {called}"
        event = xosc.Event(name, xosc.Priority.parallel)
        event.add_trigger(_build_time_trigger(xosc, float(self._seconds[frame])))
        event.add_action(name, action)
        maneuver.add_event(event)

    def _trajectory(self, xosc: Any, number: int, first: int, last: int) -> Any:
        trajectory = xosc.Trajectory(f"{self.name} track {number}", False)
        frames = range(first, last + 1)
        places = [self._place(xosc, frame) for frame in frames]
        trajectory.add_shape(xosc.Polyline([float(self._seconds[frame]) for frame in frames], places))
        absolute = xosc.ReferenceContext.absolute
        return xosc.FollowTrajectoryAction(trajectory, xosc.FollowingMode.position, absolute, 1.0, 0.0)

    def _place(self, xosc: Any, frame: int) -> Any:
        x, y, z = map(float, self._ground[frame])
        return xosc.WorldPosition(x, y, z, float(self._yaw[frame]))


def find_stretches(valid: Bools) -> list[tuple[int, int]]:
    """First and last frame of each stretch of frames at which something is there."""
    edges = np.diff(np.concatenate([[0], np.asarray(valid, np.int64), [0]]))
    return list(zip(np.flatnonzero(edges > 0).tolist(), (np.flatnonzero(edges < 0) - 1).tolist(), strict=True))


def _build_time_trigger(xosc: Any, seconds: float, trigger: str = "start") -> Any:
    """Once the simulation is so old."""
    condition = xosc.SimulationTimeCondition(seconds, xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger("time", 0.0, xosc.ConditionEdge.none, condition, triggeringpoint=trigger)
