"""Cells, pillars and cameras one at a time; turned views against rotation in double precision."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.networks.layers.bev_geometry import BEVGrid, find_visible_cells, previous_cell_matrix, rotate_view

GRID = BEVGrid(6, 4, (-15.0, -30.0, -2.0, 15.0, 30.0, 2.0))


def cameras(seed: int, count: int = 3) -> torch.Tensor:
    """Cameras at the origin that look outwards, each with its own heading: metres to pixels of 60 x 100 images."""
    random = np.random.default_rng(seed)
    matrices = []
    for heading in random.uniform(0, 2 * math.pi, count):
        forward = np.array([math.cos(heading), math.sin(heading), 0.0])
        right = np.array([math.sin(heading), -math.cos(heading), 0.0])
        rows = np.stack([right, [0.0, 0.0, -1.0], forward])
        intrinsic = np.array([[40.0, 0, 50], [0, 40.0, 30], [0, 0, 1]])
        matrix = np.eye(4)
        matrix[:3, :3] = intrinsic @ rows
        matrix[:3, 3] = intrinsic @ random.normal(size=3)
        matrices.append(matrix)
    return torch.from_numpy(np.stack(matrices))


def test_cells_go_row_by_row_from_the_rear_left() -> None:
    centres, pillars = GRID.centres(), GRID.pillars(4)
    torch.testing.assert_close(centres[0], torch.tensor([0.5 / 4, 0.5 / 6]))
    torch.testing.assert_close(centres[1], torch.tensor([1.5 / 4, 0.5 / 6]))
    torch.testing.assert_close(centres[4], torch.tensor([0.5 / 4, 1.5 / 6]))
    torch.testing.assert_close(pillars[1, :, 0], torch.full((4,), -15 + 1.5 * 7.5))
    torch.testing.assert_close(pillars[4, :, 1], torch.full((4,), -30 + 1.5 * 10.0))
    torch.testing.assert_close(pillars[0, :, 2], torch.tensor([-1.5, -0.5, 0.5, 1.5]))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_hits_are_what_each_camera_sees(seed: int) -> None:
    pillars, projections = GRID.pillars(2), cameras(seed)
    hits = find_visible_cells(pillars, projections, 60, 100)
    found = {
        (int(camera), int(cell)): points for camera, cell, points in zip(hits.camera, hits.cell, hits.image_points)
    }
    counts = [0] * GRID.cells
    for camera in range(len(projections)):
        for cell in range(GRID.cells):
            seen = False
            for height, place in enumerate(pillars[cell].double()):
                u, v, depth, _ = projections[camera] @ torch.cat([place, torch.ones(1, dtype=torch.float64)])
                x, y = float(u) / max(float(depth), 1e-5) / 100, float(v) / max(float(depth), 1e-5) / 60
                seen |= float(depth) > 1e-5 and 0 < x < 1 and 0 < y < 1
                if (camera, cell) in found and float(depth) > 0.1:
                    expected = torch.tensor([x, y])
                    torch.testing.assert_close(found[camera, cell][height], expected, rtol=1e-4, atol=1e-4)
            assert seen == ((camera, cell) in found)
            counts[cell] += seen
    assert hits.cameras_per_cell.flatten().tolist() == [max(1, count) for count in counts]
    assert hits.camera.tolist() == sorted(hits.camera.tolist())
    by_cell = sorted(range(len(hits.cell)), key=lambda pair: (int(hits.cell[pair]), int(hits.camera[pair])))
    assert hits.cell_order.tolist() == by_cell
    assert hits.cell_starts.tolist() == [sum(counts[:cell]) for cell in range(GRID.cells)]


@settings(max_examples=25, deadline=None)
@given(
    angle=st.floats(-400, 400),
    centre=st.tuples(st.floats(-5, 12), st.floats(-5, 12)),
    rows=st.integers(1, 9),
    columns=st.integers(1, 9),
)
def test_a_turned_view_takes_the_nearest_cell(
    angle: float, centre: tuple[float, float], rows: int, columns: int
) -> None:
    grid = BEVGrid(rows, columns, GRID.range_m)
    view = torch.arange(1.0, grid.cells + 1)[:, None].expand(-1, 2)
    turned = rotate_view(view, grid, previous_cell_matrix(grid, angle, centre))
    cosine, sine = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    for row in range(rows):
        for column in range(columns):
            x, y = column + 0.5 - centre[0], row + 0.5 - centre[1]
            from_column = cosine * x - sine * y + centre[0] - 0.5
            from_row = sine * x + cosine * y + centre[1] - 0.5
            if min(abs(from_column % 1 - 0.5), abs(from_row % 1 - 0.5)) < 1e-3:
                continue
            source = (round(from_row), round(from_column))
            inside = 0 <= source[0] < rows and 0 <= source[1] < columns
            expected = float(source[0] * columns + source[1] + 1) if inside else 0.0
            assert turned[row * columns + column].tolist() == [expected, expected]


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
def test_a_quarter_turn_is_exact_in_any_precision(precision: torch.dtype) -> None:
    grid = BEVGrid(5, 5, GRID.range_m)
    view = torch.randn(25, 3).to(precision)
    turned = rotate_view(view, grid, previous_cell_matrix(grid, 90.0, (2.5, 2.5)))
    # Counter-clockwise in an image whose rows go down.
    assert torch.equal(turned.view(5, 5, 3), torch.rot90(view.view(5, 5, 3), 1, (0, 1)))
    assert torch.equal(rotate_view(view, grid, previous_cell_matrix(grid, 360.0, (2.5, 2.5))), view)
