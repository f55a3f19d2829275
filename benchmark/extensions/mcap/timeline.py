"""Messages of Foxglove's schemas by time: what is said on which topic, and the primitives they are made of.

Needs ``foxglove-sdk`` (extra ``mcap``). Quaternions are x, y, z, w there; ours are w, x, y, z.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from benchmark.constants import EGO_BODY_WIDTH_M, EGO_CENTER_FROM_REAR_AXLE_M, EGO_HEIGHT_M, EGO_LENGTH_M
from benchmark.errors import InputError
from benchmark.geometry import Floats, quaternion_from_yaw

NEEDS_A_PACKAGE: Final = (
    "writing MCAP needs the package foxglove-sdk; install it with: pip install 'challenger-bench[mcap]'"
)
MAP: Final = "map"
EGO_FRAME: Final = "base_link"
_JSON: Final = "json"
_CHUNK_BYTES: Final = 4 << 20
"""A tenth less than with 1 MiB, the package's own, since boxes repeat what they were in the frames before."""


def load_messages() -> Any:
    """``foxglove.messages``; `InputError` where the package is not installed."""
    try:
        from foxglove import messages
    except ImportError as error:
        raise InputError(NEEDS_A_PACKAGE) from error
    return messages


@dataclass(slots=True)
class Timeline:
    """Messages of one file, in the order in which they are given; they are written by time.

    ``schemas`` are JSON schemas by topic, of topics with JSON messages; ``metadata`` is by topic too. A message is
    made when it is written, so that one picture at a time is in memory.
    """

    entries: list[tuple[int, str, Callable[[], Any]]] = field(default_factory=list)
    schemas: dict[str, dict[str, Any]] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def add(self, time_us: int, topic: str, message: Any) -> None:
        """Say something at a time."""
        self.entries.append((int(time_us) * 1000, topic, lambda: message))

    def add_later(self, time_us: int, topic: str, make: Callable[[], Any]) -> None:
        """Say something that is made when it is written."""
        self.entries.append((int(time_us) * 1000, topic, make))

    def write(self, stream: Any, records: Mapping[str, Mapping[str, str]]) -> None:
        """Write an MCAP file to a stream that can seek, with metadata records by name."""
        import foxglove
        from foxglove import channels
        from foxglove.mcap import MCAPWriteOptions

        context = foxglove.Context()
        # More threads than one would only be faster on much larger files.
        options = MCAPWriteOptions(compression_threads=0, chunk_size=_CHUNK_BYTES)
        opened: dict[str, Any] = {}
        with foxglove.open_mcap(stream, context=context, writer_options=options) as writer:
            for name, record in records.items():
                writer.write_metadata(name, dict(record))
            for time_ns, topic, make in sorted(self.entries, key=lambda entry: entry[0]):
                message = make()
                if topic not in opened:
                    about = self.metadata.get(topic)
                    if topic in self.schemas:
                        schema = self.schemas[topic]
                        stored = foxglove.Schema(
                            name=schema["title"], encoding="jsonschema", data=json.dumps(schema).encode()
                        )
                        opened[topic] = foxglove.Channel(
                            topic, message_encoding=_JSON, schema=stored, context=context, metadata=about
                        )
                    else:
                        kind = getattr(channels, f"{type(message).__name__}Channel")
                        opened[topic] = kind(topic, context=context, metadata=about)
                opened[topic].log(message, log_time=time_ns)


class Primitives:
    """Foxglove's messages from arrays; ``messages`` is `load_messages`."""

    def __init__(self) -> None:
        self.messages = load_messages()

    def time(self, time_us: int) -> Any:
        """A timestamp."""
        seconds, rest = divmod(int(time_us), 1_000_000)
        return self.messages.Timestamp(seconds, rest * 1000)

    def pose(self, position: Floats, rotation: Floats) -> Any:
        """From (3,) metres and (4,) w, x, y, z."""
        return self.messages.Pose(position=self.vector(position), orientation=self.quaternion(rotation))

    def planar_pose(self, x: float, y: float, z: float, yaw: float) -> Any:
        """On the ground."""
        return self.pose(np.array([x, y, z]), quaternion_from_yaw(np.array(yaw)))

    def vector(self, values: Floats) -> Any:
        """(3,)."""
        x, y, z = map(float, values)
        return self.messages.Vector3(x=x, y=y, z=z)

    def quaternion(self, rotation: Floats) -> Any:
        """(4,) w, x, y, z."""
        w, x, y, z = map(float, rotation)
        return self.messages.Quaternion(x=x, y=y, z=z, w=w)

    def colour(self, rgb: Sequence[int], alpha: float = 1.0) -> Any:
        """0 to 255."""
        red, green, blue = (value / 255.0 for value in rgb)
        return self.messages.Color(r=red, g=green, b=blue, a=alpha)

    def cube(self, pose: Any, size: Floats, colour: Any) -> Any:
        """Length, width, height."""
        return self.messages.CubePrimitive(pose=pose, size=self.vector(size), color=colour)

    def ego_body(self, time_us: int, frame: str, rgb: Sequence[int], alpha: float) -> Any:
        """A scene update with the ego's body, in a frame at its rear axle."""
        centre = self.planar_pose(EGO_CENTER_FROM_REAR_AXLE_M, 0.0, EGO_HEIGHT_M / 2, 0.0)
        size = np.array([EGO_LENGTH_M, EGO_BODY_WIDTH_M, EGO_HEIGHT_M])
        return self.update(
            [self.entity(time_us, "ego", frame, cubes=[self.cube(centre, size, self.colour(rgb, alpha))])]
        )

    def line(self, points: Floats, colour: Any, thickness: float, *, closed: bool = False) -> Any:
        """Through (N, 3) points, metres."""
        kinds = self.messages.LinePrimitiveLineType
        return self.messages.LinePrimitive(
            type=kinds.LineLoop if closed else kinds.LineStrip,
            pose=self.planar_pose(0.0, 0.0, 0.0, 0.0),
            thickness=thickness,
            points=[self.messages.Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in points],
            color=colour,
        )

    def text(self, words: str, position: Floats, colour: Any) -> Any:
        """A label that faces the reader."""
        pose = self.pose(position, np.array([1.0, 0.0, 0.0, 0.0]))
        return self.messages.TextPrimitive(
            pose=pose, billboard=True, font_size=14.0, scale_invariant=True, color=colour, text=words
        )

    def entity(
        self, time_us: int, identifier: str, frame: str = MAP, *, facts: Mapping[str, str] | None = None, **parts: Any
    ) -> Any:
        """An object of a scene update that stays until it is deleted or replaced, or for its ``lifetime``."""
        pairs = [self.messages.KeyValuePair(key=name, value=value) for name, value in (facts or {}).items()]
        return self.messages.SceneEntity(
            timestamp=self.time(time_us), frame_id=frame, id=identifier, frame_locked=True, metadata=pairs, **parts
        )

    def update(self, entities: Iterable[Any], deletions: Iterable[Any] = ()) -> Any:
        """A scene update."""
        return self.messages.SceneUpdate(entities=list(entities), deletions=list(deletions))

    def deletion(self, time_us: int, identifier: str) -> Any:
        """An object is gone."""
        kind = self.messages.SceneEntityDeletionType.MatchingId
        return self.messages.SceneEntityDeletion(timestamp=self.time(time_us), type=kind, id=identifier)

    def transform(self, time_us: int, parent: str, child: str, translation: Floats, rotation: Floats) -> Any:
        """Where a frame is in its parent."""
        return self.messages.FrameTransform(
            timestamp=self.time(time_us),
            parent_frame_id=parent,
            child_frame_id=child,
            translation=self.vector(translation),
            rotation=self.quaternion(rotation),
        )

    def log(self, time_us: int, level: str, message: str, name: str) -> Any:
        """An event; ``level`` is ``Info``, ``Warning`` or ``Error``."""
        return self.messages.Log(
            timestamp=self.time(time_us), level=getattr(self.messages.LogLevel, level), message=message, name=name
        )
