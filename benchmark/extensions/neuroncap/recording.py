"""What NeuroNCAP's engine reads of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.neuroncap.actors import FURTHER_VEHICLES, KEPT_CLASSES, Actor, Integers
from benchmark.extensions.neuroncap.poses import heading_of
from benchmark.geometry import Floats, transform_matrix
from benchmark.records.neuroncap_switches import Switches

Singles = NDArray[np.float32]
CAN_COLUMNS = 16
"""Of a CAN row: position 3, rotation w x y z, acceleration 3, rotation rate 3, velocity 3."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One scene with F keyframes.

    Attributes:
        poses: (F, 4, 4) rear axle to global.
        canbus: (F, 16) row of each frame.
        steering_wheel: (F,) radians.
        actors: Its own actors, in order of first appearance.
    """

    times: Integers
    poses: Floats
    canbus: Singles
    steering_wheel: Singles
    actors: tuple[Actor, ...]

    @property
    def path(self) -> Floats:
        """(F, 3) x, y, yaw of all frames."""
        return np.array([[*pose[:2, 3], heading_of(pose)] for pose in self.poses])


def at_frames(times: Integers, message_times: Integers, values: Floats) -> Singles:
    """Messages of frames in single precision: the first one at or after each, the last one if none is.

    (F,) times of frames, (M,) rising times of messages and (M, ...) values become (F, ...).
    """
    at = np.minimum(np.searchsorted(message_times, times), len(message_times) - 1)
    return np.asarray(values[at], np.float32)


def steering_at_frames(times: Integers, message_times: Integers, degrees: Floats) -> Singles:
    """(F,) angle of the steering wheel in radians, from (M,) messages in degrees."""
    # Times pi, then by 180, each rounded, as in the published code.
    return np.asarray(at_frames(times, message_times, degrees) * np.float32(np.pi) / np.float32(180), np.float32)


@dataclass(frozen=True, slots=True)
class Annotations:
    """A annotations of I instances, in the data set's order.

    Attributes:
        frame: (A,) keyframe of each.
        instance: (A,) index of each one's instance.
        translation: (A, 3) box centre, global, metres.
        rotation: (A, 4) quaternions w, x, y, z.
        size: (A, 3) width, length, height.
        tokens: I instance tokens.
        categories: I category names.
    """

    frame: Integers
    instance: Integers
    translation: Floats
    rotation: Floats
    size: Floats
    tokens: Sequence[str]
    categories: Sequence[str]


def actors_of(annotations: Annotations, times: Integers, switches: Switches) -> tuple[Actor, ...]:
    """Actors of the recording's own that are of the classes the engine keeps, in order of first appearance.

    The size is that of the first annotation, and a gap between annotations is driven through in a straight line. The
    switches decide whether construction and emergency vehicles are kept.
    """
    kept = {*KEPT_CLASSES, *(FURTHER_VEHICLES if switches.classes == "paper" else ())}
    actors = []
    for instance in dict.fromkeys(annotations.instance.tolist()):
        kind = [*annotations.categories[instance].split("."), ""][1]
        if kind not in kept:
            continue
        rows = np.flatnonzero(annotations.instance == instance)
        rows = rows[np.argsort(annotations.frame[rows], kind="stable")]
        poses = [transform_matrix(annotations.rotation[row], annotations.translation[row]) for row in rows]
        stamps = times[annotations.frame[rows]]
        actors.append(Actor(annotations.tokens[instance], kind, annotations.size[rows[0]], stamps, np.array(poses)))
    return tuple(actors)
