"""Engines by name: what ``--engine``, ``--agents`` and ``--latency`` mean together."""

from collections.abc import Mapping
from typing import Any, Final

from benchmark.closed_loop.adversary import ADVERSARY, AdversaryFactory, ScriptedTracks
from benchmark.closed_loop.default_engine import AGENTS, DefaultBackend
from benchmark.closed_loop.simulation_state import SimulatorBackend
from benchmark.closed_loop.world_state import ENGINE
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.extension import OFFERS, call_extension, list_offers
from benchmark.records.drive_schema import OF_FILE, RECORDED, SCENARIOS, ClosedLoopDefinition, StopCondition

STOP_CONDITIONS: Final[Mapping[str, StopCondition]] = {
    "contact": "contact",
    "fault": "fault@1",
    "fault@1": "fault@1",
    "fault@nuplan": "fault@nuplan",
}
"""Events that end a drive, by what ``--until`` says."""


def list_engines() -> tuple[str, ...]:
    """Names that ``--engine`` takes, those of extensions too."""
    return ENGINE, *list_offers("engine", (ENGINE,))


def make_backend(
    engine: str,
    agents: str = "replay",
    latency_ms: int = 0,
    scenarios: str = RECORDED,
    adversary: AdversaryFactory | None = None,
    until: str = "contact",
    scenario_facts: Mapping[str, Any] | None = None,
) -> SimulatorBackend:
    """Maker of rides of an engine, one of `list_engines`; refuses what the engine does not have.

    ``latency_ms`` is how much later a plan takes effect; ``scenarios``, a name or the path of a file, and their facts,
    as a record has them, count in NeuroNCAP's engine only. Without an adversary factory, only drives with stored tracks
    begin. ``until``, one of `STOP_CONDITIONS`, ends a drive before its time.
    """
    engines = list_engines()
    if engine not in engines:
        raise InputError(f"unknown engine {engine!r}; {did_you_mean(engine, engines)}choose from {', '.join(engines)}")
    if agents not in AGENTS:
        known = " and ".join([", ".join(AGENTS[:-1]), AGENTS[-1]])
        raise InputError(f"unknown agents {agents!r}; {did_you_mean(agents, AGENTS)}choose from {known}")
    facts = dict(scenario_facts or {})
    if not is_scenario_file(scenarios) and (scenarios not in SCENARIOS or (scenarios == OF_FILE and not facts)):
        names = [name for name in SCENARIOS if name != OF_FILE]
        raise InputError(
            f"unknown scenarios {scenarios!r}; {did_you_mean(scenarios, names)}choose from {', '.join(names)} and "
            "scenario files of NeuroNCAP (FILE.yaml)"
        )
    if until not in STOP_CONDITIONS:
        raise InputError(
            f"unknown --until {until!r}; {did_you_mean(until, STOP_CONDITIONS)}choose from {', '.join(STOP_CONDITIONS)}"
        )
    if engine == ENGINE:
        if scenarios != RECORDED or facts:
            raise InputError(f"scenarios need NeuroNCAP's engine; use --engine {engines[1]} or leave --scenarios out")
        return DefaultBackend(
            agents, 1000 * latency_ms, adversary if agents == ADVERSARY else None, STOP_CONDITIONS[until]
        )
    if agents != "replay" or latency_ms:
        raise InputError(f"road users of {engine} never react and plans take effect at once; use --engine {ENGINE}")
    if until != "contact":
        raise InputError(f"every collision ends a run of {engine}; use --engine {ENGINE} or leave --until {until} out")
    if facts and engine not in OFFERS["engine"]:
        raise InputError(f"{engine} has no targets and no scenario files; leave them out")
    more = {"facts": facts} if facts else {}
    backend: SimulatorBackend = call_extension("engine", engine, engine, scenarios, **more)
    return backend


def is_scenario_file(scenarios: str) -> bool:
    """Whether scenarios are named by the path of a YAML file."""
    return scenarios.lower().endswith((".yaml", ".yml"))


def restore_backend(measured: ClosedLoopDefinition) -> SimulatorBackend:
    """Maker of the rides of a record again; an adversary drives its stored track, from `benchmark.runs.redriving`."""
    stored = (
        ScriptedTracks({}, str(measured.agents_facts.get("others", "replay"))) if measured.agents == ADVERSARY else None
    )
    return make_backend(
        measured.engine,
        measured.agents,
        measured.latency_ms,
        measured.scenarios,
        stored,
        measured.rule or "contact",
        measured.scenario_facts,
    )
