"""How severe plans are in open loop: the ego drives each plan through what really happened in the next 3 s.

``docs/severity.md``, "A plan in open loop". All plans of a scene are measured at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.fairness.contact_fault import attribute_contact
from benchmark.fairness.fault_definition import ContactTracks
from benchmark.fairness.near_misses import compute_ego_velocities, measure_near_misses
from benchmark.fairness.plan_tracks import RoadUserAhead, place_lidar_boxes, trace_plan_contact
from benchmark.geometry import Bools, Floats, boxes_overlap, ego_footprints
from benchmark.interactions.contacts import (
    KINDS,
    ContactKind,
    ContactPairs,
    compute_delta_v,
    compute_fatal_probability,
    is_agent_category,
    is_at_fault,
    mass_kg,
)
from benchmark.interactions.tracks import STEP_S, ContinuousTracks, Integers
from benchmark.protocols.exact import INSTANTS_PER_STEP, compute_plan_boxes, interpolate_object_boxes
from benchmark.records.row_schema import PlanCollision, PlanNearRow, PlanSeverityRow
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

INSTANTS: Final = PLAN_STEPS * INSTANTS_PER_STEP + 1
"""The present, and every 0.1 s up to 3 s."""
DECIMALS: Final = 6
"""Of stored numbers: below them, processors differ."""
_SAMPLES_AT_ONCE: Final = 128
"""Bounds the memory of a long scene: 128 samples of 60 objects need about 40 MB."""
_TIMES: Final = STEP_S * np.arange(INSTANTS)


class LaneLookup(Protocol):
    """The part of a map that blame needs."""

    def unsure(self, boxes: Floats) -> Bools:
        """Whether each of (Q, 5) boxes, global, is in several lanes or off the drivable area."""


@dataclass(frozen=True, slots=True)
class _PlanSurroundings:
    """N agents around S samples in the lidar frame of each: (N, 31, 5) boxes.

    ``sample`` says of which; ``counts``, (N, 31), which are there, without those that touch the ego in the present.
    """

    sample: Integers
    names: tuple[str, ...]
    categories: tuple[str, ...]
    adversary: Bools
    boxes: Floats
    counts: Bools

    @classmethod
    def of(cls, truths: Sequence[SampleTruth]) -> "_PlanSurroundings":
        sample = np.repeat(np.arange(len(truths)), [len(truth.instances) for truth in truths])
        keyframes = np.concatenate([truth.boxes for truth in truths])
        annotated = np.concatenate([truth.annotated for truth in truths])
        boxes, present = interpolate_object_boxes(keyframes, annotated)
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

    def ahead(self, row: int) -> RoadUserAhead:
        """One agent."""
        return RoadUserAhead(self.names[row], self.categories[row], self.boxes[row], self.counts[row])

    def velocities(self, rows: Integers) -> Floats:
        """(Q, 31, 2) of (Q,) agents, m/s; zero for what is no agent."""
        categories = tuple(self.categories[row] for row in rows.tolist())
        tracks = ContinuousTracks(_TIMES, np.zeros((INSTANTS, 5)), self.boxes[rows], self.counts[rows], categories)
        moves = np.array([is_agent_category(name) for name in categories])[:, None, None]
        return np.asarray(tracks.velocities_at(_TIMES) * moves)


_PRESENT: Final = ego_footprints(np.array([0.0, 0.0, np.pi / 2]))
"""(5,) the ego at the sample in its lidar frame, x right, y forward."""


def measure_plan_severities(
    truths: Sequence[SampleTruth], plans_lidar: Floats, lanes: LaneLookup | None = None, scene: Scene | None = None
) -> list[PlanSeverityRow]:
    """Measure S plans; of agents that are touched at the same instant the first by name counts, as in ``exact``.

    ``plans_lidar`` (S, 6, 2) are waypoints of the lidar origin, x right, y forward, metres. Without lanes nuPlan's rule
    does not tell whose fault a lateral contact is; ``fault@1`` needs the scene, for what both did before.
    """
    plans = np.asarray(plans_lidar, np.float64)
    starts = range(0, len(truths), _SAMPLES_AT_ONCE)
    batches = [slice(start, start + _SAMPLES_AT_ONCE) for start in starts]
    return [row for batch in batches for row in _measure_batch(truths[batch], plans[batch], lanes, scene)]


def trace_first_contact(truth: SampleTruth, plan_lidar: Floats, scene: Scene) -> ContactTracks | None:
    """Tracks up to the first contact of a (6, 2) plan, as `measure_plan_severities` finds it; ``None`` without one."""
    ego = np.concatenate([_PRESENT[None], compute_plan_boxes(np.asarray(plan_lidar, np.float64)[None])[0]])
    world = _PlanSurroundings.of([truth])
    rows, instants = _find_first_hits(ego[None], world)
    if not len(rows):
        return None
    return trace_plan_contact(scene, truth, ego, world.ahead(int(rows[0])), int(instants[0]))


def _measure_batch(
    truths: Sequence[SampleTruth], plans_lidar: Floats, lanes: LaneLookup | None, scene: Scene | None
) -> list[PlanSeverityRow]:
    ego = np.concatenate([np.broadcast_to(_PRESENT, (len(truths), 1, 5)), compute_plan_boxes(plans_lidar)], axis=1)
    world = _PlanSurroundings.of(truths)
    contacts = _measure_contacts(ego, world, truths, lanes, scene)
    without_contact = np.array([contact is None for contact in contacts])
    near = _measure_near_misses(ego, world, without_contact)
    return [PlanSeverityRow(contact=contact, near=near.get(sample)) for sample, contact in enumerate(contacts)]


def _measure_contacts(
    ego: Floats,
    world: _PlanSurroundings,
    truths: Sequence[SampleTruth],
    lanes: LaneLookup | None,
    scene: Scene | None,
) -> list[PlanCollision | None]:
    contact_rows: list[PlanCollision | None] = [None] * len(truths)
    rows, instants = _find_first_hits(ego, world)
    if not len(rows):
        return contact_rows
    samples = world.sample[rows]
    mine = ego[samples, instants]
    speed = np.hypot(*compute_ego_velocities(ego[samples])[np.arange(len(rows)), instants].T)
    pairs = ContactPairs(
        ego=mine,
        ego_speed=speed,
        other=world.boxes[rows, instants],
        other_velocity=world.velocities(rows)[np.arange(len(rows)), instants],
        is_agent=np.array([is_agent_category(world.categories[row]) for row in rows]),
    )
    masses = np.array([mass_kg(world.categories[row]) for row in rows])
    impact, kinds = pairs.impact_speed, [KINDS[kind] for kind in pairs.kinds]
    changes = compute_delta_v(impact, masses)
    unsure = _find_ambiguous_lanes(mine, kinds, [truths[sample].lidar_pose for sample in samples], lanes)
    tracks = [
        trace_plan_contact(scene, truths[sample], ego[sample], world.ahead(row), instant)
        for sample, row, instant in zip(samples.tolist(), rows.tolist(), instants.tolist())
        if scene is not None
    ]
    for place, (sample, row) in enumerate(zip(samples.tolist(), rows.tolist())):
        fault = is_at_fault(kinds[place], bool(unsure[place]))
        contact_rows[sample] = PlanCollision(
            time_s=_rounded(_TIMES[instants[place]]),
            kind=kinds[place].value,
            at_fault=None if lanes is None and kinds[place] is ContactKind.LATERAL else fault,
            impact_speed_m_s=_rounded(impact[place]),
            delta_v_ego_m_s=_rounded(changes[0][place]),
            delta_v_other_m_s=_rounded(changes[1][place]),
            fatal_probability=_rounded(compute_fatal_probability(changes[0][place])),
            agent=world.names[row],
            adversary=bool(world.adversary[row]),
            fault=None if scene is None else attribute_contact(scene, tracks[place]),
        )
    return contact_rows


def _find_first_hits(ego: Floats, world: _PlanSurroundings) -> tuple[Integers, Integers]:
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


def _find_ambiguous_lanes(
    boxes: Floats, kinds: Sequence[ContactKind], lidar_poses: Sequence[Floats], lanes: LaneLookup | None
) -> Bools:
    """Whether a lateral contact is the ego's fault; the map is asked about no other."""
    unsure = np.zeros(len(kinds), np.bool_)
    lateral = np.flatnonzero([kind is ContactKind.LATERAL for kind in kinds])
    if lanes is not None and len(lateral):
        unsure[lateral] = lanes.unsure(place_lidar_boxes(boxes[lateral], np.array(lidar_poses)[lateral]))
    return unsure


def _measure_near_misses(ego: Floats, world: _PlanSurroundings, spared: Bools) -> dict[int, PlanNearRow]:
    """Of samples without contact, by sample."""
    rows = np.flatnonzero(world.adversary & spared[world.sample] & world.counts.any(axis=1))
    if not len(rows):
        return {}
    samples = world.sample[rows]
    measures = measure_near_misses(ego[samples], world.boxes[rows], world.counts[rows], world.velocities(rows))
    nearest: dict[int, PlanNearRow] = {}
    for sample in dict.fromkeys(samples.tolist()):
        own = samples == sample
        nearest[sample] = PlanNearRow(
            least_gap_m=_rounded(measures.gap[own].min()),
            least_ttc_s=_finite(measures.ttc[own].min()),
            tet_s=_rounded(measures.tet[own].max()),
            tit_s2=_rounded(measures.tit[own].max()),
            pet_s=_finite(measures.pet[own].min()),
            max_btn=_rounded(measures.btn[own].max()),
        )
    return nearest


def _finite(value: float) -> float | None:
    return _rounded(value) if np.isfinite(value) else None


def _rounded(value: float | Floats) -> float:
    return round(float(value), DECIMALS)
