"""What a renderer of NeuroNCAP is asked and answers: actors with their tracks, and one picture of one camera."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.http.requests import encoded, parsed
from benchmark.extensions.http.values import FARTHEST_M, WireError, matrix_of, member, numbers_of
from benchmark.geometry import Floats
from benchmark.untrusted.limits import WIRE_ANSWER

_BODY: Final = "the answer of /get_actors"
_LONGEST_ID: Final = 200
_MOST_ACTORS: Final = 5000


@dataclass(frozen=True, slots=True)
class RendererActor:
    """Actor that a renderer can show elsewhere than recorded.

    Attributes:
        timestamps: (T,) microseconds.
        poses: (T, 4, 4) of the box's centre, global.
        dims: (3,) width, length, height.
    """

    uuid: str
    timestamps: NDArray[np.int64]
    poses: Floats
    dims: Floats

    @classmethod
    def read(cls, value: Any, where: str) -> Self:
        """Read one."""
        uuid = member(value, "uuid", where)
        if not isinstance(uuid, str) or not 0 < len(uuid) <= _LONGEST_ID:
            raise WireError(f"{where}.uuid is no text of 1 to {_LONGEST_ID} characters")
        times = member(value, "timestamps", where)
        if (
            not isinstance(times, list)
            or not times
            or not all(type(each) is int and abs(each) < 1 << 53 for each in times)
        ):
            raise WireError(f"{where}.timestamps is no list of whole microseconds")
        poses = numbers_of(member(value, "poses", where), f"{where}.poses")
        if poses.shape != (len(times), 4, 4) or not np.isfinite(poses).all() or np.abs(poses).max() > FARTHEST_M:
            raise WireError(f"{where}.poses is not a pose of 4 x 4 for each of {len(times)} timestamps")
        return cls(
            uuid, np.array(times, np.int64), poses, matrix_of(member(value, "dims", where), (3,), f"{where}.dims")
        )


@dataclass(frozen=True, slots=True)
class MovedActor:
    """Where an actor is to be shown.

    Attributes:
        timestamps: (T,) microseconds.
        poses: (T, 4, 4) of the box's centre, global.
        dims: (3,) width, length, height.
        is_target: Whether it is who threatens the ego.
    """

    timestamps: NDArray[np.int64]
    poses: Floats
    dims: Floats
    uuid: str
    is_target: bool


def actors_in(body: bytes) -> tuple[RendererActor, ...]:
    """Actors of an answer to ``/get_actors``."""
    value = parsed(body, WIRE_ANSWER, _BODY)
    if not isinstance(value, list) or len(value) > _MOST_ACTORS:
        raise WireError(f"{_BODY} is no list of at most {_MOST_ACTORS} actors")
    return tuple(RendererActor.read(each, f"actor {number}") for number, each in enumerate(value))


def moved(actors: Iterable[MovedActor]) -> bytes:
    """The body of ``/update_actors``."""
    return encoded(
        [
            {
                "timestamps": each.timestamps.tolist(),
                "poses": each.poses.tolist(),
                "dims": each.dims.tolist(),
                "uuid": each.uuid,
                "is_target_actor": each.is_target,
            }
            for each in actors
        ]
    )


def picture_wanted(pose: Floats, timestamp: int, camera: str, image_format: str | None = None) -> bytes:
    """The body of ``/render_image``: (4, 4) global pose of a camera, and microseconds.

    Args:
        image_format: A member that NeuroNCAP never sends and NeuRAD's server knows: ``png``.
    """
    more = {} if image_format is None else {"image_format": image_format}
    return encoded({"pose": pose.tolist(), "timestamp": timestamp, "camera_name": camera, **more})
