"""The parts of the training of VAD-mini: what ``challenger-bench train planner`` runs for it."""

from adapters.extensions.training.front import Eyes, front_phase, of_all_cameras
from adapters.extensions.training.phases import Phase
from adapters.extensions.training.trainer import Recipe
from adapters.extensions.training.vad.objective import COARSE, VADObjective
from adapters.extensions.training.vad.planner_objective import PlannerObjective
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.vad.model import VAD


def front_reader(network: VAD) -> FrontReader | None:
    """The part of a network that reads the front camera for its plan, if it has one."""
    return network.pts_bbox_head.front_reader


def front_eyes(network: VAD) -> Eyes:
    """Eyes that make the maps for the front phase."""
    if network.front_eyes is not None:
        return Eyes(network.front_eyes, own=True)
    return of_all_cameras(network, (COARSE,))


def phases() -> tuple[Phase, ...]:
    """The parts of the training of VAD-mini."""
    everything = Recipe(steps=6000, learning_rate=4e-4, warmup=150, clips=2, check_every=1500)
    planner = Recipe(steps=2500, learning_rate=6e-4, warmup=100, clips=24, check_every=1000)
    return (
        front_phase(front_reader, front_eyes),
        Phase("all", VADObjective, everything),
        Phase("planner", PlannerObjective, planner),
    )
