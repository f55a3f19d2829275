"""The part of a drive that is scored: from the first driven instant to the contact that ends it, or the end."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.episodes import Episode
from benchmark.closed_loop.simulation_state import (
    ACCELERATION,
    SPEED,
    STEERING,
    SUBSTEP_S,
    YAW,
    YAW_RATE,
    EpisodeMotion,
)
from benchmark.geometry import Bools, Floats
from benchmark.pdm import definition as pdm
from benchmark.scene import Scene


@dataclass(frozen=True, slots=True)
class DrivenPart:
    """F instants, 0.1 s apart, of a drive in a scene of N agents: boxes (N, F, 5), presence (N, F).

    ``states`` are (F, 11) of the ego, in the columns of `benchmark.pdm.definition`; ``velocity`` is (N, F, 2), m/s over
    the last 0.1 s, the next one where an agent has just come.
    """

    scene: Scene
    times_us: NDArray[np.int64]
    states: Floats
    boxes: Floats
    velocity: Floats
    present: Bools

    @classmethod
    def of(cls, scene: Scene, drive: Episode) -> "DrivenPart":
        """The scored part of a drive that did not fail."""
        motion = drive.motion
        first = int(motion.ticks[min(drive.primed, len(motion.ticks)) - 1])
        last = len(motion.times_us)
        if drive.touch is not None:
            # The instant at or after the contact belongs to it: what the car was doing then is known.
            last = min(int(np.searchsorted(motion.times_us, drive.touch.time_us)) + 1, last)
        kept = slice(min(first, last - 1), last)
        boxes = motion.boxes(scene.agents.size)
        velocity = _velocities(boxes[..., :2], motion.present, motion.seconds)
        return cls(
            scene,
            motion.times_us[kept],
            _states(motion)[kept],
            boxes[:, kept],
            velocity[:, kept],
            motion.present[:, kept],
        )


def _states(motion: EpisodeMotion) -> Floats:
    """(F, 11) the motion in the columns of driving scores; the acceleration across is that of the bend."""
    ego, states = motion.ego, np.zeros((len(motion.ego), pdm.STATE_COLUMNS))
    states[:, : pdm.HEADING + 1] = ego[:, : YAW + 1]
    states[:, pdm.SPEED], states[:, pdm.ACCELERATION] = ego[:, SPEED], ego[:, ACCELERATION]
    states[:, pdm.STEERING], states[:, pdm.YAW_RATE] = ego[:, STEERING], ego[:, YAW_RATE]
    states[:, pdm.SIDE_ACCELERATION] = ego[:, SPEED] * ego[:, YAW_RATE]
    states[1:, pdm.STEERING_RATE] = np.diff(ego[:, STEERING]) / SUBSTEP_S
    states[1:, pdm.YAW_ACCELERATION] = np.diff(ego[:, YAW_RATE]) / SUBSTEP_S
    return states


def _velocities(places: Floats, present: Bools, seconds: Floats) -> Floats:
    """(N, F, 2) of agents with (N, F, 2) places."""
    if places.shape[1] < 2:
        return np.zeros_like(places)
    step = np.diff(places, axis=1) / np.diff(seconds)[:, None]
    both = present[:, 1:] & present[:, :-1]
    nothing = np.zeros_like(places[:, :1])
    before = np.concatenate([nothing, np.where(both[..., None], step, 0.0)], axis=1)
    after = np.concatenate([np.where(both[..., None], step, 0.0), nothing], axis=1)
    came = np.concatenate([np.ones_like(present[:, :1]), ~both], axis=1)
    return np.where(came[..., None], after, before)
