"""One run with its recorded plans: states, sub-steps, checks, boxes of actors, the contact, and the score."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.neuroncap.loop import (
    Engine,
    World,
    begin,
    command_of,
    finished,
    goes_on,
    step,
)
from benchmark.extensions.neuroncap.poses import heading_of
from benchmark.extensions.neuroncap.recording import CAN_COLUMNS
from benchmark.extensions.neuroncap.score import score_of
from benchmark.extensions.neuroncap.vehicle import SUBSTEPS
from benchmark.extensions.neuroncap.verification.checked_moments import CHECK_COLUMNS, CheckRow, checks_of
from benchmark.extensions.neuroncap.verification.driving import COMMAND_COLUMNS, STATE_COLUMNS, state_errors
from benchmark.extensions.neuroncap.verification.golden_set import beyond_single, plans_of, with_nan
from benchmark.geometry import Floats, wrap_angle
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays

_SAME_RATE: Final = 1e-9
_BOX_COLUMNS: Final = 8
_YAW: Final = 3


def compare_run(
    comparison: Comparison,
    engine: Engine,
    run: dict[str, Any],
    stored: GoldenArrays,
    *,
    turning_freely: frozenset[str],
) -> None:
    """Drive a run of the published engine again and compare it with the stored arrays.

    Args:
        turning_freely: Actors whose headings are not compared.
    """
    replay = _Replay(comparison, engine, stored, run["key"], turning_freely)
    world = replay.drive()
    comparison.verdicts("number of actors", len(engine.actors) != run["n_engine_actors"])
    comparison.verdicts("inferences", [replay.asked != run["n_infer_calls"], replay.asked != len(replay.plans)])
    comparison.verdicts("states checked", world.checked != run["n_states_checked"])
    _compare_contact(comparison, world, run["collision"])
    _compare_scores(comparison, engine, world, run)


class _Replay:
    """A run with recorded plans, compared state by state."""

    def __init__(
        self, comparison: Comparison, engine: Engine, stored: GoldenArrays, key: str, turning_freely: frozenset[str]
    ) -> None:
        self._comparison, self._engine, self._turning_freely = comparison, engine, turning_freely
        self.asked = 0
        self._times = stored.integers(f"{key}_state_time", None)
        count = len(self._times)
        self._poses = stored.floats(f"{key}_state_pose", count, 4, 4)
        self._canbus = stored.floats(f"{key}_state_canbus", count, CAN_COLUMNS)
        self._commands = stored.integers(f"{key}_command", count)
        self.plans = plans_of(stored, f"{key}_plan", [PLAN_STEPS] * count)
        self._post_times = stored.integers(f"{key}_post_time", None)
        steps = len(self._post_times)
        self._post_poses = stored.floats(f"{key}_post_pose", steps, 4, 4)
        self._post_canbus = stored.floats(f"{key}_post_canbus", steps, CAN_COLUMNS)
        self._post_driven = stored.verdicts(f"{key}_post_auto", steps)
        driven = int(np.count_nonzero(self._post_driven))
        self._states = stored.floats(f"{key}_substep_state", driven, SUBSTEPS, len(STATE_COLUMNS))
        self._asked = stored.floats(f"{key}_substep_command", driven, SUBSTEPS, len(COMMAND_COLUMNS))
        self._checks = stored.floats(f"{key}_check", None, CHECK_COLUMNS)
        self._boxes = stored.floats(f"{key}_actor_box", None, _BOX_COLUMNS)
        self._found: list[CheckRow] = []

    def drive(self) -> World:
        """From the start to the end, as long as there are plans."""
        engine, world, driven = self._engine, begin(self._engine), 0
        while goes_on(engine, world) and self.asked < len(self.plans):
            number = self.asked
            self._compare_state(world, number)
            waiting = world.waiting
            world = step(engine, world, self.plans[number])
            self._found += checks_of(self._engine, waiting, number - 1)
            self.asked += 1
            if world.contact is not None:
                break
            self._compare_step(world, number, driven)
            driven += int(world.state.is_driven)
        last = world.waiting
        world = finished(engine, world)
        self._found += checks_of(self._engine, last, self.asked - 1)
        self._comparison.verdicts("steps", bool(driven != len(self._states)))
        self._compare_checks()
        return world

    def _compare_state(self, world: World, number: int) -> None:
        state = world.state
        self._comparison.verdicts("times", bool(state.time_us != self._times[number]))
        self._comparison.numbers("poses (m)", state.pose, self._poses[number])
        self._canbus_rows(state.canbus.astype(np.float64), self._canbus[number])
        self._comparison.verdicts("commands", bool(command_of(self._engine, world) != self._commands[number]))
        rows = self._boxes[self._boxes[:, 0] == number]
        ours = [self._box(int(index), state.time_us) for index in rows[:, 1]]
        if len(rows):
            boxes = np.array(ours)
            others = [column for column in range(boxes.shape[1]) if column != _YAW]
            self._comparison.numbers("boxes of actors (m)", boxes[:, others], rows[:, 2:][:, others])
            turned = wrap_angle(boxes[:, _YAW] - rows[:, 2 + _YAW])
            free = np.array([self._uuid(int(index)) in self._turning_freely for index in rows[:, 1]])
            self._comparison.errors("headings of actors (rad)", turned[~free])

    def _box(self, index: int, time_us: int) -> tuple[float, ...]:
        """x, y, z, yaw, width and length of an actor."""
        if not 0 <= index < len(self._engine.actors):
            return (np.nan,) * (_BOX_COLUMNS - 2)
        actor = self._engine.actors[index]
        pose = actor.pose_at(time_us)
        return (*pose[:3, 3].tolist(), heading_of(pose), *actor.size[:2].tolist())

    def _uuid(self, index: int) -> str:
        return self._engine.actors[index].uuid if 0 <= index < len(self._engine.actors) else ""

    def _compare_step(self, world: World, number: int, driven: int) -> None:
        if number >= len(self._post_times) or (world.last is not None and driven >= len(self._states)):
            self._comparison.verdicts("steps", True)
            return
        state = world.state
        self._comparison.verdicts("times", bool(state.time_us != self._post_times[number]))
        self._comparison.verdicts("steps", bool(state.is_driven != self._post_driven[number]))
        self._comparison.numbers("poses (m)", state.pose, self._post_poses[number])
        self._canbus_rows(state.canbus.astype(np.float64), self._post_canbus[number])
        if world.last is not None:
            self._comparison.errors("states of sub-steps", state_errors(world.last.states, self._states[driven]))
            self._comparison.numbers("commands of sub-steps", world.last.commands, self._asked[driven])

    def _compare_checks(self) -> None:
        ours, golden = np.array(self._found).reshape(-1, CHECK_COLUMNS), self._checks
        self._comparison.verdicts("number of checks", bool(len(ours) != len(golden)))
        if len(ours) != len(golden):
            return
        wrong = (ours[:, [0, 1, -1]] != golden[:, [0, 1, -1]]).any(axis=1)
        self._comparison.verdicts("instants and verdicts of checks", wrong)
        self._comparison.numbers("places of checks (m)", ours[:, 2:4], golden[:, 2:4])
        turned = wrap_angle(ours[:, 4] - golden[:, 4])
        self._comparison.errors("headings of checks (rad)", turned)
        self._comparison.numbers("speeds of checks (m/s)", ours[:, 5], golden[:, 5])

    def _canbus_rows(self, ours: Floats, golden: Floats) -> None:
        self._comparison.errors("CAN rows, beyond one step of single precision", beyond_single(ours, golden))


def _compare_contact(comparison: Comparison, world: World, golden: dict[str, Any] | None) -> None:
    contact = world.contact
    comparison.verdicts("contact", (contact is None) != (golden is None))
    if contact is None or golden is None:
        return
    found = (contact.uuid, contact.index, contact.is_target, contact.time_us)
    wanted = (golden[name] for name in ("actor", "actor_index", "is_target", "time"))
    comparison.verdicts("who is touched, and when", [ours != theirs for ours, theirs in zip(found, wanted)])
    comparison.numbers("IoU", contact.iou, golden["iou"])
    comparison.numbers("velocity of the ego (m/s)", contact.ego_velocity, golden["ego_velocity"])
    comparison.numbers("velocity of the actor (m/s)", contact.actor_velocity, golden["actor_velocity"])


def _compare_scores(comparison: Comparison, engine: Engine, world: World, run: dict[str, Any]) -> None:
    """Score, its parts, and the file of metrics; the paper's reference speed with all else as code."""
    golden = with_nan(run)
    for reading in ("code", "paper"):
        switches = replace(engine.switches, reference_speed=reading)
        score = score_of(replace(engine, switches=switches), world)
        _score(comparison, f"score, {reading}", score.score, golden[f"nns_{reading}"])
        speed = golden[f"reference_speed_{reading}"]
        comparison.numbers(f"reference speed, {reading} (m/s)", score.reference_speed, speed)
        if reading == "paper":
            continue
        comparison.numbers("impact speed (m/s)", score.impact_speed, golden["impact_speed"])
        for name, ours in score.metrics.items():
            theirs = float(golden["metrics"].get(name, np.inf))
            if name == "ncap_score":
                _score(comparison, "score in the file", ours, theirs)
            else:
                comparison.verdicts("rates in the file", not abs(float(ours) - theirs) <= _SAME_RATE)


def _score(comparison: Comparison, name: str, ours: float, golden: float) -> None:
    """A score; NaN must be NaN."""
    comparison.errors(name, 0.0 if np.isnan(ours) and np.isnan(golden) else ours - golden)
