"""Manoeuvres on request: what an adversary is asked for, whether it can do it, and when it has done it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.errors import InputError, did_you_mean
from benchmark.geometry import Bools, Floats
from benchmark.scene import Scene
from generation.labels.interactions import compute_path_interaction
from generation.labels.labelling import read_agent_boxes
from generation.labels.manoeuvres import ALONG_RAD, Manoeuvre, find_occurrences
from generation.search.manoeuvre_conditions import EgoAtFrames, ManoeuvrePlacement, compute_missing, split_side
from generation.search.recorded_ego_path import RecordedEgoPath
from generation.search.threat import EgoLookahead

FALLBACK_KINDS: Final = (Manoeuvre.PASSING_WIDE, Manoeuvre.DISTANT)
"""Manoeuvres that apply when no other does, and cannot be requested."""
REQUESTABLE_KINDS: Final = tuple(kind for kind in Manoeuvre if kind not in FALLBACK_KINDS)
READY_FRAMES: Final = 24
"""Within so many frames a vehicle that cuts in was outside."""
LOOK_AHEAD_FRAMES: Final = 48
"""Frames after the driven track that tell whether it has done what was asked."""


@dataclass(frozen=True, slots=True)
class ManoeuvreRequest:
    """A manoeuvre asked of one adversary, in the scene before it acts; ``start`` is the frame of its launch."""

    kind: Manoeuvre
    scene: Scene
    agent: int
    start: int

    def at(self, frame: int, offsets: tuple[int, ...], track: Floats) -> Callable[[Floats, Floats], Floats]:
        """Function of (B, S, 3) poses and (B, S) speeds that gives the (B,) mean of `compute_missing`, metres.

        Of the S frames after the planning frame every half second is looked at; ``track`` are the (F, 3) executed poses
        of the box centre from the launch to that frame.
        """
        ahead = EgoLookahead.of(self.scene, frame, offsets)
        ego, columns = EgoAtFrames.of(self.scene, ahead.frames, ahead.way), list(ahead.columns)
        size = self.scene.agents.size[self.agent, :2]
        ready = self._ready(track, ahead.way)

        def cost(center: Floats, speed: Floats) -> Floats:
            center, speed = center[:, columns], speed[:, columns]
            finite = np.isfinite(center).all(axis=-1) & np.isfinite(speed)
            placed = ManoeuvrePlacement.of(
                ego, np.where(finite[..., None], center, 0.0), np.where(finite, speed, 0.0), size
            )
            return np.asarray(compute_missing(self.kind, placed, ready=ready).mean(axis=1))

        return cost

    def is_fulfilled(self, track: Floats) -> bool:
        """Whether the executed track has the kind already, by the label itself."""
        end = self.start + len(track)
        # The label looks as far ahead as the ego gets in 3 s, plus one second to settle.
        visible = slice(0, end + LOOK_AHEAD_FRAMES)
        boxes = read_agent_boxes(self.scene, self.agent)[visible]
        boxes[self.start : end, [0, 1, 4]] = track
        # Extrapolated at constant speed: speeds at the last frame look ahead.
        step = track[-1, :2] - track[-2, :2] if len(track) > 1 else np.zeros(2)
        boxes[end:, [0, 1, 4]] = track[-1]
        boxes[end:, :2] += step * np.arange(1, len(boxes) - end + 1)[:, None]
        driven = np.zeros(len(boxes), dtype=np.bool_)
        driven[self.start : end] = True
        interaction = compute_path_interaction(
            self.scene.ego.boxes[visible], boxes, self.scene.seconds[visible], driven, self.start
        )
        return any(occurrence.kind == self.kind.value for occurrence in find_occurrences(interaction))

    def _ready(self, track: Floats, way: RecordedEgoPath) -> bool:
        """Whether, within the last two seconds, the vehicle was clear of the strip on the side that is asked for."""
        _, side = split_side(self.kind)
        recent = track[-READY_FRAMES:]
        last = self.start + len(track)
        ego = EgoAtFrames.of(self.scene, tuple(range(last - len(recent), last)), way)
        placed = ManoeuvrePlacement.of(
            ego, recent[None], np.zeros((1, len(recent))), self.scene.agents.size[self.agent, :2]
        )
        return bool((side * placed.offset - placed.half_width > ego.half_width).any())


def parse_manoeuvre(name: str) -> Manoeuvre:
    """The kind of a name; `InputError` for an unknown one, and for kinds that cannot be requested."""
    kinds = [kind.value for kind in REQUESTABLE_KINDS]
    if name in FALLBACK_KINDS:
        raise InputError(f"{name} applies when no other kind does; request one of {', '.join(kinds)}")
    if name not in kinds:
        raise InputError(f"unknown manoeuvre {name!r}; {did_you_mean(name, kinds)}use one of {', '.join(kinds)}")
    return Manoeuvre(name)


def can_perform(kind: Manoeuvre, scene: Scene, agent: int, start: int) -> bool:
    """Whether a vehicle drives in a direction that allows the requested manoeuvre; none turns round for it.

    For `ONCOMING` it is opposing at the launch; for `CROSSING` its recording is ever across the ego's path from then
    on; for every other kind it is not opposing at the launch.
    """
    boxes, present = read_agent_boxes(scene, agent), scene.agents.valid[agent]
    turn = np.abs(compute_path_interaction(scene.ego.boxes, boxes, scene.seconds, present, start).other.turn)
    opposing = turn >= np.pi - ALONG_RAD
    match kind:
        case Manoeuvre.ONCOMING:
            return bool(opposing[0])
        case Manoeuvre.CROSSING:
            across: Bools = (turn > ALONG_RAD) & ~opposing & present[start:]
            return bool(across.any())
        case _:
            return not bool(opposing[0])
