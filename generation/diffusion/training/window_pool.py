"""Windows of a folder of tracks, by source, and how training draws from them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion.standardiser import actions_from_waypoints
from generation.diffusion.training.track_sources import find_track_sources, source_windows
from generation.diffusion.training.tracks import Windows


@dataclass(frozen=True, slots=True)
class TrackData:
    """Windows of a folder of tracks, by source.

    Attributes:
        training: To learn from.
        held_out: To check with, possibly empty.
        licences: Of every source.
    """

    training: dict[str, Windows]
    held_out: dict[str, Windows]
    licences: dict[str, str]


def load_track_data(folder: Path, held_out: tuple[str, ...], stride_s: float) -> TrackData:
    """Cut every source of a folder.

    Args:
        folder: Of recordings, in any of the forms that `find_track_sources` knows.
        held_out: Names of sources not to learn from.
        stride_s: Time between the starts of training windows; held-out windows start every half second.

    Returns:
        See `TrackData`; sources without a usable window are left out.

    Raises:
        InputError: If a source is broken, or nothing is left to learn from.
    """
    training: dict[str, Windows] = {}
    checking: dict[str, Windows] = {}
    licences: dict[str, str] = {}
    for source in find_track_sources(folder):
        windows, licence = source_windows(source, 0.5 if source.name in held_out else stride_s)
        if len(windows.previous):
            (checking if source.name in held_out else training)[source.name] = windows
            licences[source.name] = licence
    if not training:
        raise InputError(f"{folder} has no window of 8.5 s of driving outside the held-out sources; add tracks")
    return TrackData(training, checking, licences)


def window_actions(windows: Windows) -> Floats:
    """(N, 16, 3) standardised actions of windows."""
    return actions_from_waypoints(windows.waypoints, windows.previous)


@dataclass(frozen=True, slots=True)
class WindowPool:
    """What training draws from.

    Attributes:
        actions: (N, 16, 3) standardised actions, source after source.
        first: (S,) where each source begins.
        count: (S,) how many windows it has.
    """

    actions: Floats
    first: np.ndarray[tuple[int], np.dtype[np.int64]]
    count: np.ndarray[tuple[int], np.dtype[np.int64]]

    @classmethod
    def of(cls, actions: Mapping[str, Floats]) -> Self:
        """Pool the (N, 16, 3) actions of several sources."""
        count = np.array([len(part) for part in actions.values()], dtype=np.int64)
        return cls(np.concatenate(list(actions.values())), np.cumsum(count) - count, count)

    def draw(self, count: int, size_jitter: float, rng: np.random.Generator) -> Floats:
        """Windows at random: a source with chance proportional to the root of its size, then a window of it.

        The root keeps one long recording from drowning the others. Half of the windows are mirrored (left and right
        are alike for a car), and all are scaled, which varies speeds.

        Args:
            count: How many.
            size_jitter: Largest relative change of size.
            rng: Chance.

        Returns:
            (count, 16, 3) actions.
        """
        share = np.sqrt(self.count)
        source = rng.choice(len(share), size=count, p=share / share.sum())
        drawn = self.actions[self.first[source] + (rng.random(count) * self.count[source]).astype(np.int64)]
        mirror = np.where(rng.random(count) < 0.5, 1.0, -1.0)
        drawn[..., 1:] *= mirror[:, None, None]
        drawn[..., :2] *= rng.uniform(1 - size_jitter, 1 + size_jitter, count)[:, None, None]
        return np.asarray(drawn)
