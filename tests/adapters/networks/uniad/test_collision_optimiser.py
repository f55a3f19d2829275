"""The collision optimisation: its derivatives, its minima, and what IPOPT makes of the same."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.networks.uniad import collision_optimiser as collision_solvers
from adapters.networks.uniad.collision_optimiser import (
    cost,
    descend,
    lowest_point,
    move_plan,
    nearby_cells,
    newton_points,
)
from benchmark.errors import InputError

PARITY = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity" / "uniad" / "dev"
FLAT = 2.507


def slow_cost(point: Any, reference: Any, cells: Any) -> float:
    total = sum((a - b) ** 2 for a, b in zip(point, reference, strict=True))
    for x, y in cells:
        total += 5 / FLAT * np.exp(-((point[0] - x) ** 2 + (point[1] - y) ** 2) / 2)
    return float(total)


places = st.floats(-4, 4)
some_cells = st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=1, max_size=40)


@settings(max_examples=20, deadline=None)
@given(places, places, some_cells)
def test_minima_are_minima(x: float, y: float, cells: list[tuple[int, int]]) -> None:
    reference, near = np.array([x, y]), np.array(cells, np.float64)
    start = cost(reference, reference, near)
    assert start == pytest.approx(slow_cost(reference, reference, cells))
    below, lowest = newton_points(reference[None], [near])[0], lowest_point(reference, near)
    for point in (below, lowest, descend(reference, near)):
        gradient = [
            (slow_cost(point + step, reference, cells) - slow_cost(point - step, reference, cells)) / 2e-4
            for step in 1e-4 * np.eye(2)
        ]
        assert np.abs(gradient).max() < 1e-4
    assert cost(lowest, reference, near) <= cost(below, reference, near) + 1e-12 <= start + 2e-12
    grid = reference + np.stack(np.meshgrid(*[np.linspace(-9, 9, 61)] * 2), -1).reshape(-1, 2)
    apart = ((grid[:, None] - near[None]) ** 2).sum(-1)
    everywhere = ((grid - reference) ** 2).sum(-1) + 5 / FLAT * np.exp(-apart / 2).sum(-1)
    assert cost(lowest, reference, near) <= everywhere.min() + 1e-9


def test_a_point_on_a_heap_of_cells_leaves_it() -> None:
    """A maximum, where the gradient is zero: IPOPT and what follows its way stay on it, and leave it from beside it."""
    here = np.array([2.0, 1.0])
    heap = np.repeat(here[None], 4, 0)
    beside = here + 1e-3
    for moved in (lowest_point(here, heap), descend(here, heap), newton_points(beside[None], [heap])[0]):
        assert np.linalg.norm(moved - here) > 0.5 and cost(moved, here, heap) < cost(here, here, heap)
    assert np.array_equal(newton_points(here[None], [heap])[0], here)


def test_cells_are_whole_metres_toward_the_lidar() -> None:
    occupied = np.zeros((200, 200), np.bool_)
    for row, column in ((100, 100), (99, 99), (103, 97), (109, 100), (112, 100)):
        occupied[row, column] = True
    # Centres (x, y) 0.25 0.25, -0.25 -0.25, -1.25 1.75, 0.25 4.75 and 0.25 6.25.
    found = nearby_cells(np.array([0.0, 0.5]), occupied)
    assert sorted(map(tuple, found.tolist())) == [(-1.0, 1.0), (0.0, 0.0), (0.0, 0.0), (0.0, 4.0)]
    assert len(nearby_cells(np.array([0.0, 5.0]), occupied)) == 3


def test_each_point_meets_the_occupancy_of_its_time() -> None:
    occupied = np.zeros((5, 200, 200), np.bool_)
    occupied[4, 100, 100] = True
    moved = move_plan(np.zeros((6, 2)), occupied)
    assert moved.cells.tolist() == [0, 0, 0, 1, 1, 1]
    assert np.array_equal(moved.points[:3], np.zeros((3, 2))) and (moved.costs <= moved.costs_before).all()
    free = move_plan(np.ones((6, 2)), np.zeros_like(occupied), "ipopt")
    assert np.array_equal(free.points, np.ones((6, 2))) and not free.cells.any()


def test_odd_plans_and_absent_casadi_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise ImportError(name)

    with pytest.raises(InputError, match="not finite"):
        move_plan(np.full((6, 2), np.nan), np.zeros((5, 200, 200), np.bool_))
    monkeypatch.setattr(collision_solvers, "import_module", absent)
    with pytest.raises(InputError, match=r"challenger-bench\[uniad\]"):
        move_plan(np.zeros((6, 2)), np.ones((5, 200, 200), np.bool_), "ipopt")


def stored(frame: int) -> tuple[Any, Any, Any, Any]:
    with np.load(PARITY / f"outputs_frame{frame}.npz") as arrays:
        occupied = np.unpackbits(arrays["occ_seg_out_bits"]).reshape(5, 200, 200).astype(np.bool_)
        before, after = (arrays[name][0].astype(np.float64) for name in ("sdc_traj_before_optim", "sdc_traj"))
        return before, after, occupied, arrays["col_optim_cells"]


@pytest.mark.skipif(not PARITY.is_dir(), reason="no shared material beside the repository")
@pytest.mark.parametrize("frame", range(4))
def test_stored_plans(frame: int) -> None:
    before, after, occupied, cells = stored(frame)
    moved, lowest = move_plan(before, occupied), move_plan(before, occupied, "lowest")
    assert moved.cells.tolist() == cells.tolist()
    np.testing.assert_allclose(moved.points, after, atol=1e-5)
    assert (lowest.costs <= moved.costs + 1e-9).all()


@pytest.mark.skipif(find_spec("casadi") is None, reason="casadi is not installed")
@pytest.mark.parametrize("seed", range(9))
def test_ipopt_arrives_at_the_same_points(seed: int) -> None:
    """On blocks, on scattered cells, and where everything is occupied."""
    generator = np.random.default_rng(seed)
    occupied = generator.random((5, 200, 200)) < (0.0, 0.7, 1.0)[seed % 3]
    for step in range(5):
        for _ in range(generator.integers(1, 4)):
            row, column = 100 + generator.integers(-16, 16, 2)
            height, width = generator.integers(2, 14, 2)
            occupied[step, row : row + height, column : column + width] = True
    plan = np.cumsum(generator.normal(0, 1.2, (6, 2)) + [0, 0.5], 0)
    official, own = move_plan(plan, occupied, "ipopt"), move_plan(plan, occupied)
    assert (own.costs <= official.costs + 1e-6).all()
    np.testing.assert_allclose(own.points, official.points, atol=1e-3)
    assert (move_plan(plan, occupied, "lowest").costs <= official.costs + 1e-6).all()
