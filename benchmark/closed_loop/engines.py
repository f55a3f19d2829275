"""Engines by name: what ``--engine``, ``--agents`` and ``--latency`` mean together."""

from typing import Final, get_args

from benchmark.closed_loop.adversary import ADVERSARY, AdversaryMaker, GivenTracks
from benchmark.closed_loop.default_engine import AGENTS, DefaultRides
from benchmark.closed_loop.riding import RideMaker
from benchmark.closed_loop.world import ENGINE
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.extension import OFFERS, from_extension
from benchmark.records.drive_schema import RECORDED, SCENARIOS, Measured, UntilName

UNTIL: Final[tuple[UntilName, ...]] = get_args(UntilName)
ENGINES: Final = (ENGINE, *OFFERS["engine"])


def rides_of(
    engine: str,
    agents: str = "replay",
    latency_ms: int = 0,
    scenarios: str = RECORDED,
    adversary: AdversaryMaker | None = None,
    until: str = "contact",
) -> RideMaker:
    """Maker of rides of an engine.

    Args:
        engine: One of `ENGINES`.
        latency_ms: So much later does a plan take effect.
        scenarios: Scenarios that scenes are driven with, in NeuroNCAP's engine.
        adversary: Puts an adversary among the agents; without one only drives with stored tracks begin.
        until: What ends a drive before its time, one of `UNTIL`.

    Raises:
        InputError: If there is no such engine or policy, or the engine has no such thing.
    """
    if engine not in ENGINES:
        raise InputError(
            f"there is no engine {engine!r}; {did_you_mean(engine, ENGINES)}there are {', '.join(ENGINES)}"
        )
    if agents not in AGENTS:
        known = " and ".join([", ".join(AGENTS[:-1]), AGENTS[-1]])
        raise InputError(f"there are no agents {agents!r}; {did_you_mean(agents, AGENTS)}there are {known}")
    if scenarios not in SCENARIOS:
        raise InputError(f"there are no scenarios {scenarios!r}; there are {', '.join(SCENARIOS)}")
    if until not in UNTIL:
        raise InputError(f"no drive ends at {until!r}; {did_you_mean(until, UNTIL)}there are {' and '.join(UNTIL)}")
    if engine == ENGINE:
        if scenarios != RECORDED:
            raise InputError(f"scenarios are of NeuroNCAP's engine; take --engine {ENGINES[1]} or leave them out")
        return DefaultRides(agents, 1000 * latency_ms, adversary if agents == ADVERSARY else None, until)
    if agents != "replay" or latency_ms:
        raise InputError(f"actors of {engine} never react and its plans take effect at once; take --engine {ENGINE}")
    if until != "contact":
        raise InputError(f"every contact ends a run of {engine}; take --engine {ENGINE} or leave --until {until} out")
    backend: RideMaker = from_extension("engine", engine)(engine, scenarios)
    return backend


def rides_as(measured: Measured) -> RideMaker:
    """Maker of the rides of a record again: an adversary drives its stored tracks.

    It needs its track, which `benchmark.runs.redriving` takes from each row.
    """
    stored = (
        GivenTracks({}, str(measured.agents_facts.get("others", "replay"))) if measured.agents == ADVERSARY else None
    )
    return rides_of(measured.engine, measured.agents, measured.latency_ms, measured.scenarios, stored, measured.until)
