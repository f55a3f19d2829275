"""What looks at a driven world for the planner: one Protocol, and the sensor that sees nothing.

The sensor is part of the name of what was measured. Those that draw are made elsewhere (`generation.render.sensor`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol, runtime_checkable

from benchmark.planning import CameraView
from benchmark.scene import Camera, Scene

NO_SENSOR: Final = "none"


class Look(Protocol):
    """A sensor made ready for one scene."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The rig that it sees with."""

    def views(self, driven: Scene) -> dict[str, CameraView]:
        """What the cameras see now.

        Args:
            driven: The world as driven; its last frame is now.

        Returns:
            Images by camera name, in memory; drawn when they are looked at.
        """


class Sensor(Protocol):
    """What cameras see of a driven world. Picklable; the same world gives the same pictures in every process."""

    @property
    def name(self) -> str:
        """Part of the name of what was measured."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """What else its pictures depend on, as plain JSON values."""

    def look(self, scene: Scene) -> Look:
        """Make ready for a scene."""


@runtime_checkable
class RemoteSensor(Protocol):
    """A sensor elsewhere: it shows one scene at a time, to one process."""

    def require_alive(self) -> None:
        """Refuse it where no server answers; raises `InputError`."""


@dataclass(frozen=True, slots=True)
class NoSensor:
    """For planners that need no images."""

    name: str = NO_SENSOR

    @property
    def facts(self) -> Mapping[str, Any]:
        """Nothing."""
        return {}

    def look(self, scene: Scene) -> "NoLook":
        """The scene's own rig, that sees nothing."""
        return NoLook(scene.cameras)


@dataclass(frozen=True, slots=True)
class NoLook:
    """A rig that sees nothing."""

    cameras: tuple[Camera, ...]

    def views(self, driven: Scene) -> dict[str, CameraView]:
        """None."""
        return {}
