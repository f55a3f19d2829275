"""Settings of closed-loop runs, and their jobs: units of work, and where each is stored."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from benchmark.closed_loop.adversary import ADVERSARY
from benchmark.closed_loop.default_engine import DefaultBackend, describe_agents, read_stop_condition
from benchmark.closed_loop.episodes import USUAL_HZ, EpisodeSpec
from benchmark.closed_loop.observation_builder import NoSensor, Sensor
from benchmark.closed_loop.planner_calls import DEFAULT_TIMEOUT_S
from benchmark.closed_loop.simulation_state import SimulatorBackend
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings
from benchmark.interactions.driver_simulation import REFERENCE_DRIVER_KINDS
from benchmark.machine.storage import content_key
from benchmark.machine.workers import Executor, LocalProcesses
from benchmark.records.drive_schema import MOST_RUNS, OF_FILE, ClosedLoopDefinition, EpisodeRow
from benchmark.records.encounter_window import ON_TRACK, EncounterWindow, WindowName
from benchmark.records.run_schema import LABELS, PlannerFacts
from benchmark.runs.code_identity import code_sha256, is_current
from benchmark.runs.encounters import Windows, find_windows, hash_windows
from benchmark.runs.plan_rows import PlannerFactory
from benchmark.runs.redriving import read_recorded_can
from benchmark.runs.units import ResultStore

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

FORMAT: Final = 1
"""Raised whenever the drives of an unchanged planner in an unchanged engine would change."""
KEPT: Final = "drives"
"""Folder of kept drives in a record's directory."""
_LOOP: Final = "benchmark.closed_loop.episodes:run_episode"


@dataclass(frozen=True, slots=True)
class EpisodeUnit:
    """One scene, one of its scenarios or windows if it has any, and one run."""

    scene: str
    run: int
    family: str = ""
    window: EncounterWindow | None = None

    @property
    def name(self) -> str:
        """Of its file."""
        of = [self.window.of] if self.window is not None and self.window.of != self.scene else []
        return "-".join([self.scene, *([self.family] if self.family else []), *of, str(self.run)])


Paths = list[list[list[float]]]
"""Waypoints of some plans, as JSON has them."""


@dataclass(frozen=True, slots=True)
class CachedEpisode:
    """Stored result of a unit.

    Drives of an earlier version of ``scoring`` are scored again. ``plan`` and ``recorded`` are of the instants at which
    the ego was still where it was recorded. ``loaded`` is the code that the planner had loaded (`hash_loaded_code`).
    """

    row: EpisodeRow
    scoring: int
    plan: Paths
    recorded: Paths
    loaded: dict[str, str]


@dataclass(frozen=True, slots=True)
class ClosedLoopJob:
    """Settings that every unit of work needs; picklable.

    ``factory`` is ``None`` where there is one planner object alone. ``ladder`` names the reference drivers of the same
    encounters; ``keep_considered`` stores what an adversary considered beside the record. ``costs`` is from
    `benchmark.records.planner_cost.cost_path`; ``None`` notes nothing.
    """

    directory: Path
    fingerprint: str
    planner: PlannerFacts
    measured: ClosedLoopDefinition
    maker: SimulatorBackend
    sensor: Sensor
    timeout_s: float
    fresh: bool
    factory: PlannerFactory | None = None
    ladder: tuple[str, ...] = ()
    keep_considered: bool = False
    costs: Path | None = None

    def key(self, unit: EpisodeUnit) -> str:
        """Content key of a unit. No score is part of it: kept drives are scored again."""
        who = self.planner.model_dump(mode="json", exclude=LABELS)
        code = [code_sha256(type(self.maker)), code_sha256(type(self.sensor)), code_sha256(EpisodeSpec, made_by=_LOOP)]
        # Only adversaries are defined outside the engine.
        adversary = getattr(self.maker, "adversary", None)
        code += [] if adversary is None else [code_sha256(type(adversary))]
        definition = self.measured.model_dump(mode="json")
        window = [] if unit.window is None else [repr(unit.window)]
        which = (unit.scene, unit.family, unit.run, *window)
        return content_key("drive", FORMAT, self.fingerprint, *which, who, definition, code)

    def maker_of(self, unit: EpisodeUnit) -> SimulatorBackend:
        """The engine that drives a unit."""
        if unit.window is None or not isinstance(self.maker, DefaultBackend):
            return self.maker
        return replace(self.maker, window=unit.window)

    def kept(self, unit: EpisodeUnit) -> CachedEpisode | None:
        """Stored result of a unit, made by code as it is now."""
        cached = None if self.fresh else self.store.get(self.key(unit), unit.name)
        return cached if cached is not None and is_current(cached.loaded) else None

    @property
    def store(self) -> ResultStore[CachedEpisode]:
        """Where drives are kept."""
        return ResultStore(self.directory / KEPT, CachedEpisode)


class EpisodeTask(NamedTuple):
    """A unit of a job."""

    job: ClosedLoopJob
    unit: EpisodeUnit


GROUPS_PER_WORKER: Final = 4
_OFFICIAL: Final = ", which exist only for original nuScenes scenes"


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """How to drive.

    Attributes:
        engine: Name of the engine, as tables show it.
        maker: The engine.
        agents: How the others behave; who makes an adversary is said by ``maker``.
        ladder: Reference drivers that drive every encounter with an adversary too, by name.
        keep_considered: Whether what an adversary considered is kept beside the record, for films and the site; no
            byte of the record depends on it. Its maker keeps it too.
        timings: Folder for notes on what planners take, one file a record; without it none are kept.
        sensor: What cameras see.
        runs: Runs of each scene; one where the engine draws nothing.
        latency_ms: So much later does a plan take effect.
        scenarios: What scenes are driven with, in NeuroNCAP's engine.
        scenes: Only these scenes of the split.
        limit: Only the first so many.
        executor: Where units are driven; the result does not depend on it.
        timeout_s: How long a plan may take.
        seed: Seed of the intervals.
        fresh: Drive again even where drives are kept.
        together: So many drives at most are under way side by side in a process, of planners that a factory builds and
            that draw nothing from a generator of the process; the result does not depend on it.
        window: Which part of adversarial scenes is driven; adversaries keep their tracks among ``idm`` agents then.
            ``None`` drives scenes as recordings are driven: all of each, and ``idm`` drives everybody.
        windows: Windows of scenes where they are known already; found in the data set otherwise.
        windows_of: The adversarial split whose windows they are, where recordings are driven.
        plan_hz: How often planners are asked in a second, 2 or 10.
    """

    engine: str
    maker: SimulatorBackend
    agents: str = "replay"
    sensor: Sensor = field(default_factory=NoSensor)
    runs: int = 1
    latency_ms: int = 0
    scenarios: str = "recorded"
    scenes: tuple[str, ...] | None = None
    limit: int | None = None
    executor: Executor = field(default_factory=LocalProcesses)
    timeout_s: float = DEFAULT_TIMEOUT_S
    seed: int = 0
    fresh: bool = False
    together: int = 1
    ladder: tuple[str, ...] = tuple(driver.value for driver in REFERENCE_DRIVER_KINDS)
    keep_considered: bool = False
    timings: Path | None = None
    window: WindowName | None = None
    windows: Windows | None = None
    windows_of: str | None = None
    plan_hz: int = USUAL_HZ

    @property
    def processes(self) -> int:
        """How many of this machine drive at the same time, as far as is known."""
        return self.executor.workers if isinstance(self.executor, LocalProcesses) else 1

    @property
    def measured(self) -> ClosedLoopDefinition:
        """The definition that a record of these drives measures."""
        on_track = ON_TRACK if self.window is not None and self.agents == "idm" else {}
        of = {} if self.windows_of is None else {"split": self.windows_of, "windows": hash_windows(self.windows or {})}
        return ClosedLoopDefinition.model_validate(
            {
                "engine": self.engine,
                "agents": self.agents,
                "sensor": self.sensor.name,
                "sensor_facts": dict(self.sensor.facts),
                "latency_ms": self.latency_ms,
                "scenarios": self.scenarios,
                "scenario_facts": getattr(self.maker, "scenario_facts", {}),
                "until": read_stop_condition(self.maker),
                "agents_facts": {**describe_agents(self.maker), **on_track},
                "window": self.window or "scene",
                "windows_of": of,
                "plan_hz": self.plan_hz,
            }
        )

    @property
    def runs_made(self) -> int:
        """Runs of each scene: what draws nothing is driven once."""
        return self.runs if self.maker.draws else 1

    def chosen(self, data: "DataSet", split: str) -> tuple[str, ...]:
        """The scenes that are driven; raises `InputError` as for an evaluation."""
        return EvalSettings(scenes=self.scenes, limit=self.limit).chosen(data, split)

    def groups(self, tasks: "list[EpisodeTask]") -> "list[list[EpisodeTask]]":
        """Tasks that are driven side by side; where there are several processes none waits for one group."""
        workers = self.executor.workers if isinstance(self.executor, LocalProcesses) else 1
        size = self.together if workers == 1 else min(self.together, -(-len(tasks) // (GROUPS_PER_WORKER * workers)))
        return [tasks[first : first + size] for first in range(0, len(tasks), max(size, 1))]

    def units_of(self, data: "DataSet", scenes: tuple[str, ...]) -> list[EpisodeUnit]:
        """Units of some scenes, none perhaps; refuses a number of runs that no record holds."""
        if not 1 <= self.runs <= MOST_RUNS:
            raise InputError(f"--runs must be at least 1 and at most {MOST_RUNS}, got {self.runs}")
        units: list[EpisodeUnit] = []
        if self.window is not None and scenes:
            windows = self.windows or find_windows(data, scenes, whole=self.window == "scene")
            runs = range(self.runs_made)
            driven = ((scene, window) for scene in scenes for window in windows.get(scene, ()))
            return [EpisodeUnit(scene, run, window=window) for scene, window in driven for run in runs]
        for scene in scenes:
            families = self.maker.families(lambda: (data.scene(scene), read_recorded_can(data, scene)))  # noqa: B023 - called at once
            units += [EpisodeUnit(scene, run, family) for family in families for run in range(self.runs_made)]
        return units

    def units(self, data: "DataSet", scenes: tuple[str, ...]) -> list[EpisodeUnit]:
        """All units, scene after scene; no scenario at all, or more runs than a record holds, is refused."""
        units = self.units_of(data, scenes)
        if not units and self.agents == ADVERSARY:
            raise InputError(
                f"no vehicle of {', '.join(scenes[:3])}{' ...' if len(scenes) > 3 else ''} can become an adversary; "
                "choose other scenes (docs/extensions/reactive_adversary.md)"
            )
        if not units and self.scenarios == OF_FILE:
            raise InputError(
                f"none of {', '.join(scenes[:3])}{' ...' if len(scenes) > 3 else ''} has all road users that "
                f"{self.measured.scenario_facts.get('file')} names; choose the scene that it was written for "
                "(docs/extensions/neuroncap.md)"
            )
        if not units:
            raise InputError(
                f"none of {', '.join(scenes[:3])}{' ...' if len(scenes) > 3 else ''} has {self.scenarios} scenarios"
                f"{_OFFICIAL if self.scenarios == 'official' else ''}; choose other scenes or other scenarios "
                "(docs/closed-loop.md)"
            )
        return units
