"""How severe plans are in open loop: the ego drives each plan through what really happened in the next 3 s.

``docs/severity.md``, "A plan in open loop". All plans of a scene are measured at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, Protocol

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.encounters.contacts import (
    KINDS,
    ContactKind,
    Pairs,
    at_fault,
    delta_v,
    fatal_probability,
    is_agent,
    mass_kg,
)
from benchmark.encounters.tracks import STEP_S, Integers, Tracks
from benchmark.geometry import Bools, Floats, boxes_overlap, ego_footprints, wrap_angle
from benchmark.protocols.exact import INSTANTS_PER_STEP, ego_boxes, object_boxes
from benchmark.severity.near_misses import ego_velocities, near_misses
from benchmark.truth import SampleTruth

INSTANTS: Final = PLAN_STEPS * INSTANTS_PER_STEP + 1
"""The present, and every 0.1 s up to 3 s."""
DECIMALS: Final = 6
"""Of stored numbers: below them, processors differ."""
_TIMES: Final = STEP_S * np.arange(INSTANTS)


class Lanes(Protocol):
    """The part of a map that blame needs."""

    def unsure(self, boxes: Floats) -> Bools:
        """Whether each of (Q, 5) boxes, global, is in several lanes or off the drivable area."""


@dataclass(frozen=True, slots=True)
class PlanContact:
    """The first contact of a plan.

    Attributes:
        time_s: When, seconds after the sample.
        agent: Instance that is touched; of several at once the first by name, as in ``exact``.
        adversary: Whether it was made to be an adversary.
        kind: What hits what.
        at_fault: Whether the ego is to blame.
        impact_speed: m/s.
        delta_v_ego: m/s.
        delta_v_other: m/s.
        p_fatal: Of those in the ego.
    """

    time_s: float
    agent: str
    adversary: bool
    kind: ContactKind
    at_fault: bool
    impact_speed: float
    delta_v_ego: float
    delta_v_other: float
    p_fatal: float


@dataclass(frozen=True, slots=True)
class PlanNear:
    """How near a plan without contact comes to the adversaries; of several, each number is that of the worst.

    Attributes:
        gap: Smallest distance, metres.
        ttc: Least time to contact, seconds; ``None`` if they never head for one another.
        tet: How long the time to contact is below 1.5 s, seconds.
        tit: By how much it is below, summed over time, s^2.
        pet: Post-encroachment time, seconds; ``None`` if the paths do not meet within 3 s.
        btn: Largest braking threat number.
    """

    gap: float
    ttc: float | None
    tet: float
    tit: float
    pet: float | None
    btn: float


@dataclass(frozen=True, slots=True)
class PlanSeverity:
    """What is said of one plan.

    Attributes:
        contact: The first contact with anybody, or ``None``.
        near: How near it comes to the adversaries; ``None`` with a contact and where no adversary is there.
    """

    contact: PlanContact | None
    near: PlanNear | None

    def as_json(self) -> dict[str, Any]:
        """JSON values, rounded."""
        return {
            name: None if part is None else {each.name: _rounded(getattr(part, each.name)) for each in fields(part)}
            for name, part in (("contact", self.contact), ("near", self.near))
        }


@dataclass(frozen=True, slots=True)
class _World:
    """Everybody around S samples in the lidar frame of each.

    Attributes:
        sample: (N,) of which sample.
        names: N instances.
        categories: N.
        adversary: (N,) whether it was made to be one.
        boxes: (N, 31, 5).
        counts: (N, 31) who is there, without those that touch the ego in the present.
    """

    sample: Integers
    names: tuple[str, ...]
    categories: tuple[str, ...]
    adversary: Bools
    boxes: Floats
    counts: Bools

    @classmethod
    def of(cls, truths: Sequence[SampleTruth]) -> "_World":
        sample = np.repeat(np.arange(len(truths)), [len(truth.instances) for truth in truths])
        keyframes = np.concatenate([truth.boxes for truth in truths])
        annotated = np.concatenate([truth.annotated for truth in truths])
        boxes, present = object_boxes(keyframes, annotated)
        boxes = np.concatenate([keyframes[:, :1], boxes], axis=1)
        present = np.concatenate([annotated[:, :1], present], axis=1)
        touching = present[:, 0] & boxes_overlap(_PRESENT, boxes[:, 0])
        return cls(
            sample=sample,
            names=tuple(name for truth in truths for name in truth.instances),
            categories=tuple(name for truth in truths for name in truth.categories),
            adversary=np.array([name in truth.adversaries for truth in truths for name in truth.instances], np.bool_),
            boxes=boxes,
            counts=present & ~touching[:, None],
        )

    def velocities(self, rows: Integers) -> Floats:
        """(Q, 31, 2) of (Q,) agents, m/s; zero for what is no agent."""
        categories = tuple(self.categories[row] for row in rows.tolist())
        tracks = Tracks(_TIMES, np.zeros((INSTANTS, 5)), self.boxes[rows], self.counts[rows], categories)
        return tracks.velocities_at(_TIMES) * np.array([is_agent(name) for name in categories])[:, None, None]


_PRESENT: Final = ego_footprints(np.array([0.0, 0.0, np.pi / 2]))
"""(5,) the ego at the sample in its lidar frame, x right, y forward."""


def plan_severities(
    truths: Sequence[SampleTruth], plans_lidar: Floats, lanes: Lanes | None = None
) -> list[PlanSeverity]:
    """Measure plans.

    Args:
        truths: S samples.
        plans_lidar: (S, 6, 2) waypoints of the lidar origin, x right, y forward, metres.
        lanes: The map; without it no lateral contact is at fault.

    Returns:
        S severities.
    """
    if not truths:
        return []
    ego = np.concatenate([np.broadcast_to(_PRESENT, (len(truths), 1, 5)), ego_boxes(plans_lidar)], axis=1)
    world = _World.of(truths)
    contacts = _contacts(ego, world, truths, lanes)
    spared = np.array([contact is None for contact in contacts])
    near = _near(ego, world, spared)
    return [PlanSeverity(contact, near.get(sample)) for sample, contact in enumerate(contacts)]


def _contacts(
    ego: Floats, world: _World, truths: Sequence[SampleTruth], lanes: Lanes | None
) -> list[PlanContact | None]:
    found: list[PlanContact | None] = [None] * len(truths)
    rows, instants = _first_hits(ego, world)
    if not len(rows):
        return found
    samples = world.sample[rows]
    mine = ego[samples, instants]
    speed = np.hypot(*ego_velocities(ego[samples])[np.arange(len(rows)), instants].T)
    pairs = Pairs(
        ego=mine,
        ego_speed=speed,
        other=world.boxes[rows, instants],
        other_velocity=world.velocities(rows)[np.arange(len(rows)), instants],
        is_agent=np.array([is_agent(world.categories[row]) for row in rows]),
    )
    masses = np.array([mass_kg(world.categories[row]) for row in rows])
    impact, kinds = pairs.impact_speed, [KINDS[kind] for kind in pairs.kinds]
    changes = delta_v(impact, masses)
    unsure = _unsure(mine, kinds, [truths[sample].lidar_pose for sample in samples], lanes)
    for place, (sample, row) in enumerate(zip(samples.tolist(), rows.tolist())):
        found[sample] = PlanContact(
            time_s=float(_TIMES[instants[place]]),
            agent=world.names[row],
            adversary=bool(world.adversary[row]),
            kind=kinds[place],
            at_fault=at_fault(kinds[place], bool(unsure[place])),
            impact_speed=float(impact[place]),
            delta_v_ego=float(changes[0][place]),
            delta_v_other=float(changes[1][place]),
            p_fatal=float(fatal_probability(changes[0][place])),
        )
    return found


def _first_hits(ego: Floats, world: _World) -> tuple[Integers, Integers]:
    """Rows of who is touched first in each sample with a contact, and at which instants."""
    mine = ego[world.sample]
    offset = world.boxes[..., :2] - mine[..., :2]
    # Two boxes can only touch if the circles around them do.
    reach = 0.5 * (np.hypot(world.boxes[..., 2], world.boxes[..., 3]) + np.hypot(*ego[0, 0, 2:4])) + 1e-6
    near = world.counts & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2)
    row, instant = np.nonzero(near)
    hit = boxes_overlap(mine[row, instant], world.boxes[row, instant])
    ranked = sorted(
        (int(world.sample[one]), int(at), world.names[one], int(one)) for one, at in zip(row[hit], instant[hit])
    )
    first = {sample: (one, at) for sample, at, _, one in reversed(ranked)}
    chosen = np.array([first[sample] for sample in sorted(first)], np.int64).reshape(-1, 2)
    return chosen[:, 0], chosen[:, 1]


def _unsure(boxes: Floats, kinds: Sequence[ContactKind], lidar_poses: Sequence[Floats], lanes: Lanes | None) -> Bools:
    """Whether a lateral contact is the ego's fault; the map is asked about no other."""
    found = np.zeros(len(kinds), np.bool_)
    lateral = np.flatnonzero([kind is ContactKind.LATERAL for kind in kinds])
    if lanes is not None and len(lateral):
        found[lateral] = lanes.unsure(_global(boxes[lateral], np.array(lidar_poses)[lateral]))
    return found


def _global(boxes: Floats, lidar_poses: Floats) -> Floats:
    """(Q, 5) boxes of a lidar frame (x right, y forward) in the world, given (Q, 3) poses of the lidar there."""
    turn = lidar_poses[:, 2] - np.pi / 2
    cos, sin = np.cos(turn), np.sin(turn)
    placed = boxes.copy()
    placed[:, 0] = lidar_poses[:, 0] + boxes[:, 0] * cos - boxes[:, 1] * sin
    placed[:, 1] = lidar_poses[:, 1] + boxes[:, 0] * sin + boxes[:, 1] * cos
    placed[:, 4] = wrap_angle(boxes[:, 4] + turn)
    return placed


def _near(ego: Floats, world: _World, spared: Bools) -> dict[int, PlanNear]:
    """Of samples without contact, by sample."""
    rows = np.flatnonzero(world.adversary & spared[world.sample] & world.counts.any(axis=1))
    if not len(rows):
        return {}
    samples = world.sample[rows]
    found = near_misses(ego[samples], world.boxes[rows], world.counts[rows], world.velocities(rows))
    nearest: dict[int, PlanNear] = {}
    for sample in dict.fromkeys(samples.tolist()):
        own = samples == sample
        nearest[sample] = PlanNear(
            gap=float(found.gap[own].min()),
            ttc=_finite(found.ttc[own].min()),
            tet=float(found.tet[own].max()),
            tit=float(found.tit[own].max()),
            pet=_finite(found.pet[own].min()),
            btn=float(found.btn[own].max()),
        )
    return nearest


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _rounded(value: Any) -> Any:
    if isinstance(value, ContactKind):
        return value.value
    return round(value, DECIMALS) if isinstance(value, float) else value
