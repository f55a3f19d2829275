"""Objects around samples: from key frames to the states of a motion, less what touches the car at the start."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats, boxes_overlap, wrap_angle
from benchmark.pdm.definition import STATES, STATES_PER_WAYPOINT

AGENT_CATEGORIES: Final = ("vehicle.", "human.")
"""Categories of moving road users; a collision with any other object costs half."""


@dataclass(frozen=True, slots=True)
class KeyFrameObjects:
    """Objects of S samples at the seven steps 0, 0.5 .. 3 s, sample after sample, global.

    Attributes:
        offsets: (S + 1,) objects of sample s are ``offsets[s]:offsets[s + 1]``.
        box: (N, 7, 3) x, y, heading of the centre.
        size: (N, 2) length, width.
        annotated: (N, 7) whether it is annotated there; at least once.
        velocity: (N, 7, 2) m/s.
        is_agent: (N,) vehicles and people, as opposed to things.
        number: (N,) of the object in its scene.
    """

    offsets: NDArray[np.int64]
    box: Floats
    size: Floats
    annotated: Bools
    velocity: Floats
    is_agent: Bools
    number: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class SampleTraffic:
    """Objects of S samples at the 31 states of a motion.

    Attributes:
        offsets: (S + 1,) objects of sample s are ``offsets[s]:offsets[s + 1]``.
        box: (N, 31, 5) boxes, global; zero where the object is not there.
        present: (N, 31) whether it is there.
        velocity: (N, 31, 2) m/s, global; zero for things and where the object is not there.
        speed: (N,) in the first state in which it is there, which the rules go by later too, m/s.
        is_agent: (N,) vehicles and people.
        number: (N,) of the object in its scene.
    """

    offsets: NDArray[np.int64]
    box: Floats
    present: Bools
    velocity: Floats
    speed: Floats
    is_agent: Bools
    number: NDArray[np.int64]

    def sample_of(self) -> NDArray[np.int64]:
        """(N,) sample of each object."""
        return np.repeat(np.arange(len(self.offsets) - 1), np.diff(self.offsets))


def interpolate_traffic(key_frames: KeyFrameObjects) -> SampleTraffic:
    """Objects between their key frames: linear, headings by the shortest turn.

    An object is there from its first to its last annotation, across key frames in between that lack it; one that is
    annotated once is there all the time, at that pose (as officially).
    """
    annotated = key_frames.annotated
    count = len(annotated)
    index = np.arange(PLAN_STEPS + 1)
    before_key = np.maximum.accumulate(np.where(annotated, index, -1), axis=1)
    after_key = np.minimum.accumulate(np.where(annotated, index, PLAN_STEPS + 1)[:, ::-1], axis=1)[:, ::-1]
    time = np.arange(STATES) / STATES_PER_WAYPOINT
    before = before_key[:, np.floor(time).astype(np.int64)]
    after = after_key[:, np.ceil(time).astype(np.int64)]
    once = annotated.sum(axis=1) == 1
    only = annotated.argmax(axis=1)[:, None]
    before, after = np.where(once[:, None], only, before), np.where(once[:, None], only, after)
    present = (before >= 0) & (after <= PLAN_STEPS)
    before, after = np.clip(before, 0, PLAN_STEPS), np.clip(after, 0, PLAN_STEPS)
    span = after - before
    fraction = np.where(span > 0, time - before, 0.0) / np.maximum(span, 1)
    rows = np.arange(count)[:, None]
    first, last = key_frames.box[rows, before], key_frames.box[rows, after]
    step = last - first
    step[..., 2] = wrap_angle(step[..., 2])
    pose = first + fraction[..., None] * step
    box = np.concatenate(
        [pose[..., :2], np.broadcast_to(key_frames.size[:, None], (count, STATES, 2)), pose[..., 2:]], axis=-1
    )
    slow, fast = key_frames.velocity[rows, before], key_frames.velocity[rows, after]
    velocity = slow + fraction[..., None] * (fast - slow)
    velocity = np.where((present & key_frames.is_agent[:, None])[..., None], velocity, 0.0)
    at_first = velocity[np.arange(count), present.argmax(axis=1)]
    return SampleTraffic(
        offsets=key_frames.offsets,
        box=np.where(present[..., None], box, 0.0),
        present=present,
        velocity=velocity,
        speed=np.hypot(at_first[:, 0], at_first[:, 1]),
        is_agent=key_frames.is_agent,
        number=key_frames.number,
    )


def find_touching_at_start(traffic: SampleTraffic, footprints: Floats) -> Bools:
    """Objects that touch the (S, 5) rectangles of the car now: log replay takes them out of all states."""
    return traffic.present[:, 0] & boxes_overlap(footprints[traffic.sample_of()], traffic.box[:, 0])


def remove_objects(traffic: SampleTraffic, objects: Bools) -> SampleTraffic:
    """The same objects with their numbers unchanged, some of them never there."""
    return replace(traffic, present=traffic.present & ~objects[:, None])
