"""One run with its recorded plans: states, sub-steps, checks, boxes of actors, the contact, and the score."""

from dataclasses import replace
from typing import Final

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
from benchmark.extensions.neuroncap.verification.driving import COMMAND_COLUMNS, STATE_COLUMNS
from benchmark.extensions.neuroncap.verification.golden_set import (
    CODE_TOLERANCE,
    NcapArrays,
    NcapFacts,
    beyond_single,
)
from benchmark.geometry import Floats, wrap_angle
from benchmark.verification.checks import Comparison

SCORE_TOLERANCE: Final = 1e-6
_HEADING: Final = STATE_COLUMNS.index("heading")
_BOX_COLUMNS: Final = 8
_YAW: Final = 3


def compare_run(
    comparison: Comparison,
    engine: Engine,
    run: NcapFacts,
    stored: NcapArrays,
    where: str,
    *,
    turning_freely: frozenset[str],
) -> None:
    """Drive a run again.

    Args:
        comparison: Takes the errors.
        engine: The run.
        run: What the published engine said of it.
        stored: Its arrays.
        where: Its name.
        turning_freely: Actors whose headings are not compared.

    Raises:
        InputError: If the arrays do not fit together.
    """
    replay = _Replay(comparison, engine, stored, run.text("key"), where)
    replay.turning_freely = turning_freely
    world = replay.drive()
    count = np.array([len(engine.actors) != run.whole("n_engine_actors")])
    comparison.verdicts("loops: number of actors", count, where=where)
    inferred = [replay.asked != run.whole("n_infer_calls"), replay.asked != len(replay.plans)]
    comparison.verdicts("loops: inferences", np.array(inferred), where=where)
    checked = np.array([world.checked != run.whole("n_states_checked")])
    comparison.verdicts("loops: states checked", checked, where=where)
    _compare_contact(comparison, world, run, where)
    _compare_scores(comparison, engine, world, run, where)


class _Replay:
    """A run with recorded plans, compared state by state."""

    def __init__(self, comparison: Comparison, engine: Engine, stored: NcapArrays, key: str, where: str) -> None:
        self._comparison, self._engine, self._where = comparison, engine, where
        self.asked = 0
        self.turning_freely: frozenset[str] = frozenset()
        shape = stored.integers(f"{key}_state_time", None)
        self._times = shape
        count = len(shape)
        self._poses = stored.floats(f"{key}_state_pose", count, 4, 4)
        self._canbus = stored.floats(f"{key}_state_canbus", count, CAN_COLUMNS)
        self._commands = stored.integers(f"{key}_command", count)
        self.plans = stored.plans(f"{key}_plan", [PLAN_STEPS] * count)
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
        self._verdicts("loops: steps", [driven != len(self._states)])
        self._compare_checks()
        return world

    def _compare_state(self, world: World, number: int) -> None:
        state = world.state
        self._verdicts("loops: times", [state.time_us != self._times[number]])
        self._numbers("loops: poses (m)", state.pose, self._poses[number])
        self._canbus_rows(state.canbus.astype(np.float64), self._canbus[number])
        self._verdicts("loops: commands", [command_of(self._engine, world) != self._commands[number]])
        rows = self._boxes[self._boxes[:, 0] == number]
        ours = [self._box(int(index), state.time_us) for index in rows[:, 1]]
        if len(rows):
            boxes = np.array(ours)
            others = [column for column in range(boxes.shape[1]) if column != _YAW]
            self._numbers("loops: boxes of actors (m)", boxes[:, others], rows[:, 2:][:, others])
            turned = wrap_angle(boxes[:, _YAW] - rows[:, 2 + _YAW])
            free = np.array([self._uuid(int(index)) in self.turning_freely for index in rows[:, 1]])
            self._comparison.errors("loops: headings of actors (rad)", turned[~free], CODE_TOLERANCE, where=self._where)

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
            self._verdicts("loops: steps", [True])
            return
        state = world.state
        self._verdicts("loops: times", [state.time_us != self._post_times[number]])
        self._verdicts("loops: steps", [state.is_driven != self._post_driven[number]])
        self._numbers("loops: poses (m)", state.pose, self._post_poses[number])
        self._canbus_rows(state.canbus.astype(np.float64), self._post_canbus[number])
        if world.last is not None:
            ours, golden = world.last.states, self._states[driven]
            error = np.abs(ours - golden)
            error[:, _HEADING] = np.abs(wrap_angle(ours[:, _HEADING] - golden[:, _HEADING]))
            self._comparison.errors("loops: states of sub-steps", error, CODE_TOLERANCE, where=self._where)
            self._numbers("loops: commands of sub-steps", world.last.commands, self._asked[driven])

    def _compare_checks(self) -> None:
        ours, golden = np.array(self._found).reshape(-1, CHECK_COLUMNS), self._checks
        self._verdicts("loops: number of checks", [len(ours) != len(golden)])
        if len(ours) != len(golden):
            return
        wrong = (ours[:, [0, 1, -1]] != golden[:, [0, 1, -1]]).any(axis=1)
        self._comparison.verdicts("loops: instants and verdicts of checks", wrong, where=self._where)
        self._numbers("loops: places of checks (m)", ours[:, 2:4], golden[:, 2:4])
        turned = wrap_angle(ours[:, 4] - golden[:, 4])
        self._comparison.errors("loops: headings of checks (rad)", turned, CODE_TOLERANCE, where=self._where)
        self._numbers("loops: speeds of checks (m/s)", ours[:, 5], golden[:, 5])

    def _numbers(self, name: str, ours: Floats, golden: Floats) -> None:
        self._comparison.numbers(name, ours, golden, CODE_TOLERANCE, where=self._where)

    def _canbus_rows(self, ours: Floats, golden: Floats) -> None:
        name = "loops: CAN rows, beyond one step of single precision"
        self._comparison.errors(name, beyond_single(ours, golden), CODE_TOLERANCE, where=self._where)

    def _verdicts(self, name: str, wrong: list[bool]) -> None:
        self._comparison.verdicts(name, np.array(wrong), where=self._where)


def _compare_contact(comparison: Comparison, world: World, run: NcapFacts, where: str) -> None:
    golden = run.inner("collision") if run.known("collision") else None
    contact = world.contact
    comparison.verdicts("loops: contact", np.array([(contact is None) != (golden is None)]), where=where)
    if contact is None or golden is None:
        return
    same = (
        contact.uuid == golden.text("actor"),
        contact.index == golden.whole("actor_index"),
        contact.is_target == golden.flag("is_target"),
        contact.time_us == golden.whole("time"),
    )
    comparison.verdicts("loops: who is touched, and when", ~np.array(same), where=where)
    comparison.numbers("loops: IoU", np.array([contact.iou]), golden.numbers("iou")[None], 1e-6, where=where)
    for name, ours in (("ego", contact.ego_velocity), ("actor", contact.actor_velocity)):
        theirs = golden.numbers(f"{name}_velocity", 3)
        comparison.numbers(f"loops: velocity of the {name} (m/s)", ours, theirs, CODE_TOLERANCE, where=where)


def _compare_scores(comparison: Comparison, engine: Engine, world: World, run: NcapFacts, where: str) -> None:
    """Score, its parts, and the file of metrics; the paper's reference speed with all else as code."""
    metrics = run.table("metrics")
    for reading in ("code", "paper"):
        switches = replace(engine.switches, reference_speed=reading)
        score = score_of(replace(engine, switches=switches), world)
        _score(comparison, f"loops: score, {reading}", score.score, run.number_or_nan(f"nns_{reading}"), where)
        golden = run.number(f"reference_speed_{reading}")
        name = f"loops: reference speed, {reading} (m/s)"
        comparison.numbers(name, np.array([score.reference_speed]), np.array([golden]), SCORE_TOLERANCE, where=where)
        if reading == "paper":
            continue
        impact = np.array([run.number("impact_speed")])
        name = "loops: impact speed (m/s)"
        comparison.numbers(name, np.array([score.impact_speed]), impact, CODE_TOLERANCE, where=where)
        for name, ours in score.metrics.items():
            if name == "ncap_score":
                _score(comparison, "loops: score in the file", ours, metrics.get(name, np.inf), where)
                continue
            wrong = name not in metrics or abs(float(ours) - float(metrics[name])) > 1e-9
            comparison.verdicts("loops: rates in the file", np.array([wrong]), where=where)


def _score(comparison: Comparison, name: str, ours: float, golden: float, where: str) -> None:
    """A score; NaN must be NaN."""
    both = np.isnan(ours) and np.isnan(golden)
    error = 0.0 if both else abs(ours - golden)
    comparison.errors(name, np.array([error]), SCORE_TOLERANCE, where=where)
