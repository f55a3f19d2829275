"""Engines by name: what ``--engine``, ``--agents`` and ``--latency`` mean together."""

from typing import Final

from benchmark.closed_loop.drives.default_engine import POLICIES, DefaultRides
from benchmark.closed_loop.drives.riding import RideMaker
from benchmark.closed_loop.neuroncap.riding import RECORDED, SCENARIOS, NeuroncapRides
from benchmark.closed_loop.neuroncap.switches import Switches
from benchmark.closed_loop.world import ENGINE
from benchmark.errors import InputError, did_you_mean

ENGINES: Final = (ENGINE, "neuroncap@code", "neuroncap@paper")


def rides_of(engine: str, agents: str = "replay", latency_ms: int = 0, scenarios: str = RECORDED) -> RideMaker:
    """What begins rides of an engine.

    Args:
        engine: One of `ENGINES`.
        agents: How the others behave.
        latency_ms: So much later does a plan take effect.
        scenarios: What scenes are driven with, in NeuroNCAP's engine.

    Returns:
        It.

    Raises:
        InputError: If there is no such engine or policy, or the engine has no such thing.
    """
    if engine not in ENGINES:
        raise InputError(
            f"there is no engine {engine!r}; {did_you_mean(engine, ENGINES)}there are {', '.join(ENGINES)}"
        )
    if agents not in POLICIES:
        raise InputError(f"there are no agents {agents!r}; {did_you_mean(agents, POLICIES)}there are replay and idm")
    if scenarios not in SCENARIOS:
        raise InputError(f"there are no scenarios {scenarios!r}; there are {', '.join(SCENARIOS)}")
    if engine == ENGINE:
        if scenarios != RECORDED:
            raise InputError(f"scenarios are of NeuroNCAP's engine; take --engine {ENGINES[1]} or leave them out")
        return DefaultRides(agents, 1000 * latency_ms)
    if agents != "replay" or latency_ms:
        raise InputError(f"actors of {engine} never react and its plans take effect at once; take --engine {ENGINE}")
    return NeuroncapRides(Switches.named(engine), scenarios)
