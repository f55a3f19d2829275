"""One vehicle of one scene, where many are searched side by side."""

from typing import Any

from benchmark.scene import Scene
from generation.search.adversary import SearchOutcome, search_vehicles
from generation.search.candidates import compute_eligibility
from generation.search.hyperparameters import HyperParameters
from generation.search.proposals import Prior


def attempt(
    scene: Scene, agent_index: int, seed: int, hyper: HyperParameters, prior: Prior, **settings: Any
) -> SearchOutcome:
    """What came of one vehicle."""
    return search_vehicles([(scene, agent_index)], seed, hyper, prior, **settings)[0]


def choose(scene: Scene, hyper: HyperParameters, seed: int) -> tuple[int, ...]:
    """Vehicles to try."""
    return tuple(vehicle.agent for vehicle in compute_eligibility(scene, hyper, seed).chosen)
