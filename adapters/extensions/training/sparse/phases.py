"""The parts of the training of the sparse miniatures: what ``challenger-bench train planner`` runs for them."""

from typing import Final

from adapters.extensions.training.front import Eyes, front_phase, of_all_cameras
from adapters.extensions.training.phases import Phase
from adapters.extensions.training.sparse.objective import SparseObjective
from adapters.extensions.training.sparse.planner_objective import PlannerObjective
from adapters.extensions.training.trainer import Recipe
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.sparse.model import SparseNetwork

_ALL: Final = Recipe(
    steps=2600, learning_rate=1e-3, encoder_rate=0.3, warmup=60, average=0.995, clips=2, gradient_norm=10.0
)
_PLANNER: Final = Recipe(
    steps=1500, learning_rate=6e-4, warmup=100, average=0.995, clips=16, gradient_norm=10.0, check_every=500
)


def front_reader(network: SparseNetwork) -> FrontReader | None:
    """The part of a network that reads the front camera for its plan, if it has one."""
    return network.head.motion_plan_head.front_reader


def front_eyes(network: SparseNetwork) -> Eyes:
    """Eyes that make the maps for the front phase."""
    if network.front_eyes is not None:
        return Eyes(network.front_eyes, own=True)
    # What finds boxes and lines reads the same maps: they stay as they are until all of it learns.
    return of_all_cameras(network, ("",))


def phases() -> tuple[Phase, ...]:
    """The parts of the training of SparseDrive-mini."""
    return (
        front_phase(front_reader, front_eyes),
        Phase("all", SparseObjective, _ALL),
        Phase("planner", PlannerObjective, _PLANNER),
    )


def diffusion_phases() -> tuple[Phase, ...]:
    """The parts of the training of DiffusionDrive-mini.

    It starts from SparseDrive (``--start-from``): what it sees is seen already, it learns to plan.
    """
    return (Phase("planner", PlannerObjective, _PLANNER),)
