"""Windows of a folder of tracks, by source, and how training draws from them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion.kinematics import compute_motion
from generation.diffusion.standardiser import convert_waypoints_to_actions
from generation.extensions.denoiser_training.track_sources import cut_source_windows, find_track_sources
from generation.extensions.denoiser_training.tracks import TrackWindows

MOST_OF_ONE_SOURCE: Final = 0.25
"""Share of a batch that one source may have, so that its roads do not become everybody's."""
SPEED_EDGES_M_S: Final = (1.0, 3.0, 5.0, 8.0, 12.0, 16.0, 22.0)
TURN_EDGES_RAD: Final = (0.1, 0.6)
"""Edges of the cells of present speed and of turn over 8 s."""
EVENING: Final = 0.3
"""How far cells are evened out: a cell's share is what it would be, to the power of one less this."""


@dataclass(frozen=True, slots=True)
class TrackData:
    """Windows of a folder of tracks by source: to learn from, and held out to check with, possibly none."""

    training: dict[str, TrackWindows]
    held_out: dict[str, TrackWindows]
    licences: dict[str, str]


def load_track_data(folder: Path, held_out: tuple[str, ...], stride_s: float) -> TrackData:
    """Cut every source with usable windows; training windows start every ``stride_s``, held-out ones every 0.5 s."""
    training: dict[str, TrackWindows] = {}
    checking: dict[str, TrackWindows] = {}
    licences: dict[str, str] = {}
    for source in find_track_sources(folder):
        windows, licence = cut_source_windows(source, 0.5 if source.name in held_out else stride_s)
        if len(windows.previous):
            (checking if source.name in held_out else training)[source.name] = windows
            licences[source.name] = licence
    if not training:
        raise InputError(f"{folder} has no window of 8.5 s of driving outside the held-out sources; add tracks")
    return TrackData(training, checking, licences)


def compute_window_actions(windows: TrackWindows) -> Floats:
    """(N, 16, 3) standardised actions of windows."""
    return convert_waypoints_to_actions(windows.waypoints, windows.previous)


@dataclass(frozen=True, slots=True)
class TrainingBatch:
    """Windows of one step: (B, 16, 3) standardised actions, and (B, 3) pose half a second before each."""

    actions: Floats
    previous: Floats


@dataclass(frozen=True, slots=True)
class WindowPool:
    """Windows to draw from, source after source: (N, 16, 3) standardised actions, (N, 3) poses 0.5 s before.

    `upto` is the (N,) cumulated chance of the windows; the last is one.
    """

    actions: Floats
    previous: Floats
    upto: Floats
    shares: dict[str, float]

    @classmethod
    def of(cls, sources: Mapping[str, TrackWindows]) -> Self:
        """Pool the windows of several sources, evenly.

        A source's share is the root of its number of windows, at most `MOST_OF_ONE_SOURCE` where there are enough
        others: one long recording does not drown the others, nor are most roads its own. Then cells of present speed
        and turn are evened out across sources (`EVENING`): cruising straight on is common everywhere.
        """
        count = np.array([len(windows.previous) for windows in sources.values()], dtype=np.int64)
        chance = np.repeat(compute_source_shares(count) / np.maximum(count, 1), count)
        joined = TrackWindows.joined(list(sources.values()))
        chance = chance * _compute_rarity(_assign_cells(joined), chance)
        chance /= chance.sum()
        source = np.repeat(np.arange(len(count)), count)
        shares = np.bincount(source, weights=chance, minlength=len(count))
        named = dict(zip(sources, map(float, shares), strict=True))
        return cls(compute_window_actions(joined), joined.previous, np.cumsum(chance), named)

    def draw(self, count: int, size_jitter: float, rng: np.random.Generator) -> TrainingBatch:
        """Random windows, half of them mirrored, as sides are alike, and scaled by ``size_jitter`` to vary speeds."""
        chosen = np.minimum(np.searchsorted(self.upto, rng.random(count), side="right"), len(self.upto) - 1)
        actions, previous = self.actions[chosen], self.previous[chosen]
        mirror = np.where(rng.random(count) < 0.5, 1.0, -1.0)
        size = rng.uniform(1 - size_jitter, 1 + size_jitter, count)
        for part, every in ((actions, (slice(None), None)), (previous, (slice(None),))):
            part[..., 1:] *= mirror[(*every, None)]
            part[..., :2] *= size[(*every, None)]
        return TrainingBatch(actions, previous)


def compute_source_shares(count: NDArray[np.int64]) -> Floats:
    """Shares, (S,), of a batch: by the roots of counts, none above `MOST_OF_ONE_SOURCE` unless others are too few."""
    share = np.sqrt(count.astype(np.float64))
    share /= share.sum()
    most = max(MOST_OF_ONE_SOURCE, 1.0 / max(int((count > 0).sum()), 1))
    capped = np.zeros(len(share), dtype=bool)
    while (over := (share > most + 1e-12) & ~capped).any():
        capped |= over
        rest = share[~capped].sum()
        share[capped] = most
        if rest > 0:
            share[~capped] *= (1.0 - most * capped.sum()) / rest
    return np.asarray(share / share.sum())


def _assign_cells(windows: TrackWindows) -> NDArray[np.int64]:
    """(N,) cell of present speed and of turn over 8 s, either way."""
    moved = compute_motion(windows.waypoints, windows.previous)
    speed = np.digitize(moved.speed[:, 0], SPEED_EDGES_M_S)
    turn = np.digitize(np.abs(moved.turn.sum(axis=1)), TURN_EDGES_RAD)
    return np.asarray(speed * (len(TURN_EDGES_RAD) + 1) + turn)


def _compute_rarity(cells: NDArray[np.int64], chance: Floats) -> Floats:
    """(N,) factors that even out what cells hold."""
    return np.asarray(np.bincount(cells, weights=chance)[cells] ** -EVENING)
