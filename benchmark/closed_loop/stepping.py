"""The `default` engine: (world, plan) -> world, half a second at a time; no clock, no input, no output.

The order inside a step is fixed:

1. the plan joins those in force, `SimulationConfig.latency_us` after it was made;
2. the ego moves: five sub-steps of 0.1 s, by the plan in force at each one's beginning (`following`);
3. the agents move, sub-step by sub-step, each seeing all as they are at its beginning (`SimulationConfig.policy`);
4. contact is looked for every 0.05 s; the first one ends the drive, or the first that is the ego's fault
   (`SimulationConfig.blamed`): then an agent that touches it otherwise is gone from the next planning instant on.

Many worlds can be stepped together. That is faster, and changes no byte of any.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.agent_policy import ActivePlan, TrafficSnapshot, make_coasting_plan
from benchmark.closed_loop.plan_tracking import (
    INSTANT_US,
    INSTANTS,
    SUBSTEP_US,
    SUBSTEPS,
    Ego,
    follow_waypoints,
)
from benchmark.closed_loop.simulation_state import CollisionEvent
from benchmark.closed_loop.world_state import SimulationConfig, StepTrace, WorldState, compute_ego_boxes
from benchmark.constants import EGO_LENGTH_M, FARTHEST_WAYPOINT_M, LONGEST_PLAN_STEPS, PLAN_STEPS
from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.machine.storage import content_seed

_ROWS: Final = SUBSTEPS * INSTANTS
"""Instants of a step."""


class InfeasiblePlanError(ValueError):
    """A plan that cannot be driven: the planner failed, and nothing is scored."""


def begin_simulation(course: SimulationConfig) -> WorldState:
    """The world at the start; agents that overlap the ego here are ignored from then on."""
    memory, moved = course.policy.init(course.start_us, content_seed(course.seed, course.scene, "agents"))
    own = compute_ego_boxes(np.array(course.start.row))
    boxes, present = moved.boxes[-1], moved.present[-1]
    ignored = np.asarray(present & boxes_overlap(own[None], boxes)) if len(boxes) else np.zeros(0, np.bool_)
    others = TrafficSnapshot(course.start_us, own, course.start.speed, boxes, present, moved.velocity)
    return WorldState(0, course.start, others, memory, ignored)


def is_running(course: SimulationConfig, world: WorldState) -> bool:
    """Whether a plan is wanted."""
    return world.contact is None and world.time_us < course.end_us


def step(course: SimulationConfig, world: WorldState, waypoints: Floats) -> WorldState:
    """The world half a second later; what are no waypoints raises `InfeasiblePlanError`.

    Waypoints are (6 to 16, 2) x forward and y left of the rear axle now, metres, 0.5 s apart.
    """
    return step_together([course], [world], [waypoints])[0]


def step_together(
    courses: Sequence[SimulationConfig], worlds: Sequence[WorldState], plans: Sequence[Floats]
) -> list[WorldState]:
    """Half a second of many worlds; arguments and errors as in `step`, the same bytes as one by one."""
    in_force = [
        _find_active_plans(course, world, require_drivable(course, plan))
        for course, world, plan in zip(courses, worlds, plans)
    ]
    egos = _simulate_egos(courses, worlds, in_force)
    moved = (
        _step_agents(course, world, plans_now, np.ascontiguousarray(egos[:, :, index]))
        for index, (course, world, plans_now) in enumerate(zip(courses, worlds, in_force))
    )
    return list(moved)


def step_replanning(
    course: SimulationConfig, world: WorldState, waypoints: Floats, replan: Callable[[WorldState], Floats]
) -> WorldState:
    """Half a second with a new plan every 0.1 s; arguments and errors as in `step`.

    ``replan`` is asked at the four instants between, unless a contact or the end came before; the trace of its world is
    that since the step began.
    """
    here = world
    for number in range(SUBSTEPS):
        asks = number > 0 and here.contact is None and here.time_us < course.end_us
        plan = require_drivable(course, replan(here) if asks else waypoints)
        plans = _find_active_plans(course, here, plan) if asks or not number else here.plans
        now = np.array([here.ego.row]).T
        targets = _find_active_plan(plans, here.time_us).compute_targets(here.time_us, now[:3, 0])
        egos = follow_waypoints(now, np.ascontiguousarray(targets[..., None]), 1)[..., 0]
        before = here.trace if number else None
        later = _step_agents(_judge_after(course, before), here, plans, np.ascontiguousarray(egos), [number])
        assert later.trace is not None
        trace = later.trace if before is None else before.then(later.trace)
        here = replace(later, step=world.step, trace=trace)
    return replace(here, step=world.step + 1)


def _judge_after(course: SimulationConfig, before: StepTrace | None) -> SimulationConfig:
    """The course for the rest of a step of which ``before`` is driven: blame depends on all of it."""
    blamed = course.blamed
    if blamed is None or before is None:
        return course
    return replace(course, blamed=lambda contact, trace: blamed(contact, before.then(trace)))


def require_drivable(course: SimulationConfig, plan: Any) -> Floats:
    """(6 to 16, 2) waypoints as in `step`, of a plan that can be driven, else `InfeasiblePlanError`."""
    try:
        waypoints = np.array(plan, np.float64)
    except (TypeError, ValueError):
        raise InfeasiblePlanError(f"a plan for {course.scene} is not a numeric array") from None
    if waypoints.ndim != 2 or waypoints.shape[1] != 2 or not PLAN_STEPS <= len(waypoints) <= LONGEST_PLAN_STEPS:
        raise InfeasiblePlanError(
            f"a plan for {course.scene} is {waypoints.shape}, not {PLAN_STEPS} to {LONGEST_PLAN_STEPS} waypoints"
        )
    if not np.isfinite(waypoints).all() or np.abs(waypoints).max() > FARTHEST_WAYPOINT_M:
        raise InfeasiblePlanError(f"a plan for {course.scene} has NaN, infinity or global coordinates")
    return waypoints


def _find_active_plans(course: SimulationConfig, world: WorldState, waypoints: Floats) -> tuple[ActivePlan, ...]:
    """Plans of this step, by when they take effect; the first one is in force at its beginning."""
    now = world.time_us
    new = ActivePlan(now, now + course.latency_us, world.ego.pose, waypoints)
    plans = (*(world.plans or (make_coasting_plan(world.ego, now),)), new)
    first = max(index for index, plan in enumerate(plans) if plan.effect_us <= now)
    return plans[first:]


def _simulate_egos(
    courses: Sequence[SimulationConfig], worlds: Sequence[WorldState], plans: Sequence[tuple[ActivePlan, ...]]
) -> Floats:
    """(11, 6, S) egos every 0.05 s.

    With a latency a plan may change within the step; such worlds are driven in two parts, by themselves.
    """
    egos = np.empty((_ROWS + 1, 6, len(worlds)))
    changes = [course.latency_us // SUBSTEP_US % SUBSTEPS for course in courses]
    for change in sorted(set(changes)):
        group = [index for index, own in enumerate(changes) if own == change]
        now = np.array([worlds[index].ego.row for index in group]).T
        for start, stop in ((0, change), (change, SUBSTEPS)):
            if start == stop:
                continue
            times = [worlds[index].time_us + start * SUBSTEP_US for index in group]
            targets = [
                _find_active_plan(plans[index], time).compute_targets(time, column[:3])
                for index, time, column in zip(group, times, now.T)
            ]
            rows = follow_waypoints(
                np.ascontiguousarray(now), np.ascontiguousarray(np.stack(targets, axis=-1)), stop - start
            )
            egos[start * INSTANTS : stop * INSTANTS + 1, :, group] = rows
            now = rows[-1]
    return egos


def _find_active_plan(plans: tuple[ActivePlan, ...], time_us: int) -> ActivePlan:
    return next(plan for plan in reversed(plans) if plan.effect_us <= time_us)


def _step_agents(
    course: SimulationConfig,
    world: WorldState,
    plans: tuple[ActivePlan, ...],
    egos: Floats,
    numbers: Sequence[int] = range(SUBSTEPS),
) -> WorldState:
    """The world after some sub-steps of a step, all by default, of which the ego's part is known, (11, 6)."""
    own, others, memory = compute_ego_boxes(egos), world.others, world.memory
    removed = [contact_before.agent for contact_before in world.passed]
    boxes, present, velocities = [], [], []
    for place, number in enumerate(numbers):
        row = INSTANTS * place
        # Making a key costs as much as replaying a sub-step.
        key = content_seed(course.seed, course.scene, world.step, number) if course.policy.draws else 0
        end = row + INSTANTS
        known = replace(others, plan=_find_active_plan(plans, others.time_us), ego_after=own[end])
        memory, moved = course.policy.act(memory, known, key)
        there = _remove_agents(moved.present, removed)
        boxes.append(moved.boxes)
        present.append(there)
        velocities.append(moved.velocity)
        time = world.time_us + (place + 1) * SUBSTEP_US
        others = TrafficSnapshot(time, own[end], float(egos[end, 3]), moved.boxes[-1], there[-1], moved.velocity)
    trace = StepTrace(egos, np.concatenate(boxes), np.concatenate(present))
    contact, passed = world.contact, world.passed
    if contact is None:
        contact, also = _find_contacts(course, world, trace, own[1:], velocities)
        if also:
            passed = (*passed, *also)
            trace.present[-1, [contact_before.agent for contact_before in also]] = False
            others = replace(others, present=trace.present[-1])
    assert others.time_us == world.time_us + len(numbers) * SUBSTEP_US
    return WorldState(
        world.step + 1, Ego.of_row(egos[-1]), others, memory, world.ignored, plans, contact, trace, passed
    )


def _remove_agents(present: Bools, removed: Sequence[int]) -> Bools:
    """(2, N) who is there, less those who are gone."""
    if not removed:
        return present
    left = present.copy()
    left[:, removed] = False
    return left


def _find_contacts(
    course: SimulationConfig, world: WorldState, trace: StepTrace, own: Floats, velocities: Sequence[Floats]
) -> tuple[CollisionEvent | None, list[CollisionEvent]]:
    """The touch that ends the drive, if any, and those before it that do not."""
    hits = _find_overlaps(own, trace.boxes, trace.present & ~world.ignored)
    passed: list[CollisionEvent] = []
    while hits.any():
        contact = _find_first_contact(course, world, trace, own, velocities, hits)
        if course.blamed is None or course.blamed(contact, trace):
            return contact, passed
        passed.append(contact)
        hits[:, contact.agent] = False
    return None, passed


def _find_first_contact(
    course: SimulationConfig,
    world: WorldState,
    trace: StepTrace,
    own: Floats,
    velocities: Sequence[Floats],
    hits: Bools,
) -> CollisionEvent:
    """The first touch of an agent; of several at an instant, the first of the list."""
    row, agent = (int(index) for index in np.argwhere(hits)[0])
    return CollisionEvent(
        agent=agent,
        uuid=course.ids[agent],
        category=course.categories[agent],
        time_us=world.time_us + (row + 1) * INSTANT_US,
        ego=own[row],
        ego_speed=float(trace.egos[row + 1, 3]),
        other=trace.boxes[row, agent],
        other_velocity=velocities[row // INSTANTS][agent],
    )


def _find_overlaps(own: Floats, boxes: Floats, counted: Bools) -> Bools:
    """(R, N) who overlaps the ego at which instant; boxes whose circles are apart are not looked at further."""
    offset = boxes[..., :2] - own[:, None, :2]
    reach = 0.5 * (np.hypot(boxes[..., 2], boxes[..., 3]) + np.hypot(EGO_LENGTH_M, own[0, 3])) + 1e-6
    near = counted & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2)
    hits = np.zeros(near.shape, np.bool_)
    rows, agents = np.nonzero(near)
    if len(rows):
        hits[rows, agents] = boxes_overlap(own[rows], boxes[rows, agents])
    return hits
