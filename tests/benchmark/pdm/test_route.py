"""Beside the lane: asked of the near pieces of a route alone, and the answer of the distance from all of it."""

import numpy as np

from benchmark.pdm.definition import STATE_COLUMNS, STATES
from benchmark.pdm.scoring import OFF_LANE_M, measure_along_route, measure_offsets


def test_being_beside_the_route_is_what_the_distance_says() -> None:
    chance = np.random.default_rng(3)
    along = np.linspace(0.0, 1.0, 120)
    route = np.column_stack([150 * along, 20 * np.sin(5 * along)])
    states = np.zeros((40, STATES, STATE_COLUMNS))
    states[..., 0] = chance.uniform(-10, 160, states.shape[:2])
    states[..., 1] = 20 * np.sin(states[..., 0] / 30) + chance.choice([0.0, 0.3, 0.5, 0.7, 9.0], states.shape[:2])
    nowhere = np.zeros(states.shape[:2], np.bool_)
    found, apart = measure_along_route(states, route, nowhere, nowhere).beside, measure_offsets(states, route)
    assert np.array_equal(found, apart > OFF_LANE_M)
    assert 100 < found.sum() < found.size - 100


def test_on_the_edge() -> None:
    route = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]])
    states = np.zeros((1, STATES, STATE_COLUMNS))
    states[0, :4, 1] = [0.5, 0.5 + 1e-12, 0.0, -0.5]
    nowhere = np.zeros((1, STATES), np.bool_)
    assert np.array_equal(
        measure_along_route(states, route, nowhere, nowhere).beside, measure_offsets(states, route) > OFF_LANE_M
    )
