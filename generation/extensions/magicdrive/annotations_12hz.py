"""Boxes at 12 Hz from annotations at 2 Hz, as the model was trained with them (section 11)."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, quaternion_from_yaw
from benchmark.scene import Scene

_NEARLY_PARALLEL = 1.0 - 1e-9


@dataclass(frozen=True, slots=True)
class BoxTracks:
    """Boxes of N objects at T frames in the global frame.

    Attributes:
        position: (N, T, 3) centres, metres.
        rotation: (N, T, 4) quaternions.
        size: (N, T, 3) length, width, height, metres.
        valid: (N, T) whether the object is there.
    """

    position: Floats
    rotation: Floats
    size: Floats
    valid: Bools


def box_tracks(scene: Scene, frames: NDArray[np.int64]) -> BoxTracks:
    """Boxes at (T,) frames of a scene, in the order of ``scene.agents``.

    A recording, whose sensors have sweeps of their own, knows boxes at its keyframes only: those in between are
    interpolated from its annotations. What was simulated (a scene of ours, and every adversary) is known at 12 Hz
    and taken as it is.
    """
    agents = scene.agents
    tracks = BoxTracks(
        position=agents.position[:, frames],
        rotation=quaternion_from_yaw(agents.yaw[:, frames]),
        size=np.repeat(agents.size[:, None], len(frames), axis=1),
        valid=agents.valid[:, frames],
    )
    if scene.sweep_poses is None:
        return tracks
    between = interpolated_annotations(scene, frames)
    simulated = np.array([name in scene.adversaries for name in agents.ids], dtype=np.bool_)
    for each in fields(BoxTracks):
        getattr(between, each.name)[simulated] = getattr(tracks, each.name)[simulated]
    return between


def interpolated_annotations(scene: Scene, frames: NDArray[np.int64]) -> BoxTracks:
    """Boxes between keyframes: those of objects that are annotated at both ends.

    ``frames`` are (T,) from the first to the last keyframe.

    Centres lie on straight lines, rotations on great arcs, at the fraction of frames passed since the earlier
    keyframe; sizes are those of the earlier keyframe.
    """
    annotations, keyframes = scene.annotations, scene.keyframes
    left = np.clip(np.searchsorted(keyframes, frames, side="right") - 1, 0, len(keyframes) - 1)
    right = np.minimum(left + 1, len(keyframes) - 1)
    fraction = (frames - keyframes[left]) / np.maximum(keyframes[right] - keyframes[left], 1)
    there = annotations.valid[:, left] & (annotations.valid[:, right] | (fraction == 0.0))
    start, end = annotations.position[:, left], annotations.position[:, right]
    return BoxTracks(
        position=start + fraction[:, None] * (end - start),
        rotation=slerp(annotations.rotation[:, left], annotations.rotation[:, right], fraction),
        size=annotations.size[:, left],
        valid=there,
    )


def slerp(first: Floats, second: Floats, fraction: Floats) -> Floats:
    """Rotations between two rotations, at constant speed on the shorter great arc.

    Quaternions, (..., 4), are normalised here; ``fraction``, (...), is broadcast against the leading axes.
    """
    first = np.asarray(first, np.float64) / np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.asarray(second, np.float64) / np.linalg.norm(second, axis=-1, keepdims=True)
    cosine = (first * second).sum(axis=-1, keepdims=True)
    # A quaternion and its negative are the same rotation; the nearer of the two is meant.
    second, cosine = np.where(cosine < 0.0, -second, second), np.minimum(np.abs(cosine), 1.0)
    share = np.asarray(fraction, np.float64)[..., None]
    angle = np.arccos(cosine)
    # On a very short arc the chord is as good, and the sine below does not vanish.
    safe = np.where(cosine > _NEARLY_PARALLEL, 1.0, np.sin(angle))
    on_chord = (1.0 - share) * first + share * second
    on_arc = (np.sin((1.0 - share) * angle) * first + np.sin(share * angle) * second) / safe
    between = np.where(cosine > _NEARLY_PARALLEL, on_chord, on_arc)
    return np.asarray(between / np.linalg.norm(between, axis=-1, keepdims=True))
