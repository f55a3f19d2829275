"""Plans of one scene as rows of JSON: the part of a run that needs the planner, done once and kept."""

import contextlib
import random
import re
import sys
import time
import traceback
from asyncio.exceptions import CancelledError
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.route import build_ride
from benchmark.constants import PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.environment import read_device_name
from benchmark.machine.metering import Meter, peak_memory_mb
from benchmark.machine.progress import CountedUnits, track_progress
from benchmark.machine.storage import content_key, content_seed
from benchmark.planning import (
    Forecasts,
    NoViewsError,
    Observation,
    Plan,
    Planner,
    PlannerAwayError,
    PlannerFailedError,
    PlannerGoneError,
    PlannerLateError,
    PlannerLostError,
    PrivilegedPlanner,
    RemotePlanner,
    SceneInfo,
    SessionPlanner,
    SupervisedPlanner,
    reads_message_after,
)
from benchmark.records.planner_cost import SceneCost
from benchmark.records.run_schema import LABELS, PlannerFacts
from benchmark.runs.code_identity import is_current
from benchmark.runs.units import ResultStore
from benchmark.scene import Scene

TIMES: Final = 5
"""Restarts of one scene at most; a planner that goes away more often fails it."""
Outcome = TypeVar("Outcome")


def run_with_restarts(work: Callable[[], Outcome], planner: Planner) -> Outcome:
    """Outcome of work that begins with `Planner.reset`, begun again each time the planner goes away half-way.

    Nothing is asked twice in between: what came before is forgotten on both sides. The work of a scene leaves nothing
    behind where it raises. A planner that does not come back, or goes again and again, raises `PlannerGoneError`.
    """
    for _ in range(TIMES):
        try:
            return work()
        except PlannerAwayError:
            if not isinstance(planner, RemotePlanner):
                raise
            planner.come_back()
    return work()


ROW_FORMAT = 2
"""Raised whenever the rows of an unchanged planner would change."""


_DIGITS = 6

FAILURES = (Exception, SystemExit, GeneratorExit, CancelledError)
"""Exceptions of planners that are caught: `sys.exit` in a planner must not end the run as if it had succeeded."""


@contextlib.contextmanager
def end_session_after(planner: Planner) -> Iterator[None]:
    """Tell a planner with a session, whatever happens, that the scene is over."""
    try:
        yield
    finally:
        if isinstance(planner, SessionPlanner):
            planner.end_session()


class PlannerFactory(Protocol):
    """Builds the same planner in any process. Must be picklable.

    Attributes:
        facts: Which planner it builds; part of the content key of every row.
    """

    @property
    def facts(self) -> PlannerFacts:
        """Identity of the planner."""

    def __call__(self) -> Planner:
        """Build it."""


def describe_sandbox_limits(factory: PlannerFactory | None) -> dict[str, Any]:
    """Limits under which a planner is watched over, for a record's configuration; empty if it is not."""
    supervision = getattr(factory, "supervision", None)
    return {} if supervision is None else {"supervision": supervision.said()}


class SceneSource(Protocol):
    """The part of a data set that planning needs."""

    def scene(self, name: str) -> Scene:
        """The whole scene."""

    def observations(self, name: str) -> Any:
        """One `Observation` for each sample, in time order."""


class BrokenImageError(InputError):
    """An image of the data set cannot be read: the data's fault, not the planner's."""


_RUN_ENDING_ERRORS = (BrokenImageError, NoViewsError, PlannerGoneError, PlannerLateError)
"""Exceptions that end a command instead of being recorded: the same command resumes."""


@dataclass(frozen=True, slots=True)
class PlannedScene:
    """Rows of one scene, a JSON object for each sample, and their cost, ``None`` where they were kept from before."""

    rows: list[dict[str, Any]]
    cost: SceneCost | None


def scene_key(fingerprint: str, split: str, scene: str, facts: PlannerFacts) -> str:
    """Content key of one scene's plan rows. No protocol is part of it: protocols judge kept plans again."""
    # The published name of a planner does not affect its plans.
    who = facts.model_dump(mode="json", exclude=LABELS)
    return content_key("plan rows", ROW_FORMAT, fingerprint, split, scene, who)


@dataclass(frozen=True, slots=True)
class CachedScenePlans:
    """Stored plans of a scene, a JSON object a sample, and the code that was loaded then (`hash_loaded_code`)."""

    rows: list[dict[str, Any]]
    loaded: dict[str, str]


def open_plan_store(directory: Path) -> ResultStore[CachedScenePlans]:
    """Where plans of the scenes of a run are kept."""
    return ResultStore(directory / "rows", CachedScenePlans)


def read_cached_plan_rows(directory: Path, name: str, key: str) -> list[dict[str, Any]] | None:
    """Rows of a scene that are kept under their content key and made by code as it is now, or ``None``."""
    cached = open_plan_store(directory).get(key, name)
    return cached.rows if cached is not None and is_current(cached.loaded) else None


def hash_sandboxed_code(planner: Planner) -> dict[str, str]:
    """Code that a planner in a process of its own has loaded by now; of others their identity says all there is."""
    return planner.loaded_code() if isinstance(planner, SupervisedPlanner) else {}


def plan_scene(
    planner: Planner, source: SceneSource, name: str, directory: Path, key: str, *, fresh: bool
) -> PlannedScene:
    """Plan every sample of a scene, or take the rows of the content key that are there already, unless ``fresh``.

    Rows of a scene in which the planner's process was lost are not kept: whether it is, and when, may be the machine's
    matter, so the same command asks again.
    """
    cached_rows = None if fresh else read_cached_plan_rows(directory, name, key)
    if cached_rows is not None:
        return PlannedScene(cached_rows, None)
    seed_everything(content_seed(key), planner)
    scene, observations = source.scene(name), list(source.observations(name))
    meter, started = Meter(), time.perf_counter()
    # Stdout belongs to the command (--json); what a planner prints goes to stderr.
    with contextlib.redirect_stdout(sys.stderr), end_session_after(planner):
        rows, lost = run_with_restarts(partial(_rows, planner, scene, observations, meter), planner)
    cost = measure_cost(planner, meter, time.perf_counter() - started)
    if not lost:
        open_plan_store(directory).put(key, CachedScenePlans(rows, hash_sandboxed_code(planner)), name)
    return PlannedScene(rows, cost)


def measure_cost(planner: Planner, meter: Meter, planning_s: float) -> SceneCost:
    """Cost of a scene as of one process, by a meter made before; of a planner elsewhere only the time is known."""
    elsewhere = isinstance(planner, RemotePlanner)
    pid = planner.pid if isinstance(planner, SupervisedPlanner) else None
    return SceneCost(
        planning_s=round(planning_s, _DIGITS),
        latency_s=[None if latency is None else round(latency, _DIGITS) for latency in meter.latency_s],
        peak_memory_mb=None if elsewhere else peak_memory_mb(pid),
        peak_device_mb=meter.peak_device_mb,
        device="elsewhere" if elsewhere else read_device_name(meter.peak_device_mb is not None),
    )


def seed_everything(seed: int, planner: Planner | None = None) -> None:
    """Seed global generators of this process, and of the planner's, so that earlier work changes no draw."""
    if isinstance(planner, SupervisedPlanner):
        planner.seed_generators(seed)
    random.seed(seed)
    np.random.seed(seed % 2**32)
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def _rows(
    planner: Planner, scene: Scene, observations: Sequence[Observation], meter: Meter
) -> tuple[list[dict[str, Any]], bool]:
    """Rows of a scene, and whether the planner's process was lost in it."""
    # A restarted scene drops the costs measured before.
    meter.latency_s.clear()
    try:
        planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
        if isinstance(planner, PrivilegedPlanner):
            planner.reveal(scene)
    except _RUN_ENDING_ERRORS:
        raise
    except FAILURES as failure:
        error = format_failure(failure)
        return [_row(observation, None, error) for observation in observations], isinstance(failure, PlannerLostError)
    asker = _PlannerInScene(planner, meter, scene)
    planned = track_progress(
        map(asker.row, observations), total=len(observations), label=scene.name, count=CountedUnits("sample")
    )
    return list(planned), asker.lost is not None


@dataclass(slots=True)
class _PlannerInScene:
    """A planner in a scene; ``lost`` says why it cannot be asked for the rest of the scene."""

    planner: Planner
    meter: Meter
    scene: Scene
    lost: str | None = None

    def row(self, observation: Observation) -> dict[str, Any]:
        """The row of a sample."""
        if self.lost is not None:
            return _row(observation, None, self.lost)
        planner = self.planner
        views = {name: replace(view, load=wrap_image_loader(view.load)) for name, view in observation.views.items()}
        ego = observation.ego if reads_message_after(planner) else replace(observation.ego, can_motion_after=None)
        try:
            observed = replace(observation, views=views, ego=ego)
            if isinstance(planner, SessionPlanner):
                last = int(self.scene.keyframes[observation.index])
                planner.take_ride(build_ride(self.scene, self.scene.ego.position, last))
            with self.meter.call():
                plan = planner.plan(observed)
            if not isinstance(plan, Plan):
                raise TypeError(
                    f"{planner.name} returned {type(plan).__name__}; a planner must return benchmark.planning.Plan"
                )
            row = _row(observation, encode_plan(plan), None)
            note = planner.take_note().text if isinstance(planner, SessionPlanner) else ""
            return {**row, "note": note} if note else row
        except _RUN_ENDING_ERRORS:
            raise
        except FAILURES as failure:
            if isinstance(failure, PlannerLostError):
                self.lost = f"not planned: at sample {observation.index} of the scene {failure}"
            return _row(observation, None, format_failure(failure))


def _row(observation: Observation, plan: dict[str, Any] | None, error: str | None) -> dict[str, Any]:
    return {
        "scene": observation.scene,
        "sample_token": observation.sample_token,
        "index": observation.index,
        "timestamp_us": observation.timestamp_us,
        "status": "failed" if plan is None else "ok",
        "ego_motion": observation.ego.source,
        "plan": plan,
        "error": error,
    }


def encode_plan(plan: Plan) -> dict[str, Any]:
    """The plan as it was given; refuses shapes that `Plan` does not have and numbers that JSON does not have."""
    modes, scores, forecasts = plan.modes, plan.mode_scores, plan.forecasts
    count = len(scores if modes is None else modes) if scores is not None else 0
    return {
        "frame": plan.frame.value,
        # A plan is checked at construction; its numbers may have been changed since.
        "waypoints": _numbers(plan.waypoints, np.shape(plan.waypoints), "waypoints"),
        "modes": None if modes is None else _numbers(modes, (len(modes), _mode_steps(plan), 2), "modes"),
        "mode_scores": None if scores is None else _numbers(scores, (count,), "mode scores"),
        "forecasts": None if forecasts is None else _forecasts_json(forecasts),
    }


def _mode_steps(plan: Plan) -> int:
    """How many steps modes may have: those of the plan, or of a plan of 3 s."""
    assert plan.modes is not None
    mode_steps, plan_steps = np.shape(plan.modes), len(plan.waypoints)
    return plan_steps if len(mode_steps) == 3 and mode_steps[1] == plan_steps else PLAN_STEPS


def _forecasts_json(forecasts: Forecasts) -> dict[str, Any]:
    parts = {"boxes": forecasts.boxes, "trajectories": forecasts.trajectories, "scores": forecasts.scores}
    if not any(map(len, parts.values())):
        # No agents are forecast: empty arrays of any shape mean that.
        return {name: [] for name in parts}
    agents, modes = len(forecasts.boxes), np.shape(forecasts.trajectories)[1]
    if not modes:
        raise ValueError("a plan's forecasts need at least one mode for each agent")
    shapes = {"boxes": (agents, 5), "trajectories": (agents, modes, PLAN_STEPS, 2), "scores": (agents, modes)}
    written = {name: _numbers(values, shapes[name], f"forecast {name}") for name, values in parts.items()}
    if not (np.asarray(forecasts.boxes, float)[:, 2:4] > 0.0).all():
        raise ValueError("a plan's forecast boxes need a length and a width above zero")
    return written


def _numbers(values: Floats, shape: tuple[int, ...], part: str) -> Any:
    array = np.asarray(values, float)
    if array.shape != shape:
        raise ValueError(f"a plan's {part} have shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"a plan's {part} must be finite numbers")
    return array.tolist()


def wrap_image_loader(load: Callable[[], NDArray[np.uint8]]) -> Callable[[], NDArray[np.uint8]]:
    """A broken image stops the run; anything else that a planner raises is the planner's failure."""

    def loaded() -> NDArray[np.uint8]:
        try:
            return load()
        except InputError as error:
            raise BrokenImageError(str(error)) from error

    return loaded


def format_failure(failure: BaseException) -> str:
    """Stored text of a failure that is being handled: its traceback, where it was raised."""
    return failure.text if isinstance(failure, PlannerFailedError) else format_traceback()


def format_traceback() -> str:
    """The traceback being handled, without what differs between machines and runs: folders and addresses."""
    text = traceback.format_exc()
    text = re.sub(r'File "([^"]*[/\\])?([^"/\\]+)"', r'File "\2"', text)
    return re.sub(r"0x[0-9a-f]{4,}", "0x...", text)
