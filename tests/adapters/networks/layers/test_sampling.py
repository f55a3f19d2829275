"""Both kernels of deformable sampling against one number at a time."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.networks.layers.deformable_attention import Kernel, deformable_sampling
from tests.adapters.networks.layers.slow_sampling import slow_sampling

KERNELS: list[Kernel] = ["bags", "grid"]


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    shapes=st.lists(st.tuples(st.integers(1, 5), st.integers(1, 5)), min_size=1, max_size=3),
    sources=st.integers(1, 3),
    heads=st.integers(1, 3),
    points=st.integers(1, 3),
    far=st.sampled_from([1.0, 10.0, 1e12]),
)
def test_both_kernels_are_the_plain_sum(
    seed: int, shapes: list[tuple[int, int]], sources: int, heads: int, points: int, far: float
) -> None:
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    queries, levels = 4, len(shapes)
    values = normal(sources, sum(rows * columns for rows, columns in shapes), heads, 5)
    references = torch.rand(queries, 1, 1, points, 2, generator=generator) * 1.4 - 0.2
    offsets = normal(queries, heads, levels, points, 2) * far
    weights = normal(queries, heads, levels, points)
    source = torch.randint(0, sources, (queries,), generator=generator)
    expected = slow_sampling(values, shapes, references, offsets, weights, source)
    for kernel in KERNELS:
        found = deformable_sampling(values, shapes, references, offsets, weights, source, kernel)
        torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=2e-5)


@pytest.mark.parametrize("kernel", KERNELS)
def test_centres_of_cells_give_cells_outside_gives_zero_and_no_queries_give_nothing(kernel: Kernel) -> None:
    values = torch.arange(1.0, 7.0).view(1, 6, 1, 1)
    x, y = torch.meshgrid((torch.arange(3) + 0.5) / 3, (torch.arange(2) + 0.5) / 2, indexing="xy")
    centres = torch.stack([x, y], -1).reshape(6, 1, 1, 1, 2)
    still, one = torch.zeros(6, 1, 1, 1, 2), torch.ones(6, 1, 1, 1)
    found = deformable_sampling(values, [(2, 3)], centres, still, one, kernel=kernel)
    torch.testing.assert_close(found[:, 0], values.flatten())
    assert not deformable_sampling(values, [(2, 3)], centres + 1, still, one, kernel=kernel).any()
    empty = (torch.zeros(0, 1, 1, 1, 2), torch.zeros(0, 2, 1, 3, 2), torch.zeros(0, 2, 1, 3), torch.zeros(0).int())
    assert deformable_sampling(torch.randn(2, 6, 2, 4), [(2, 3)], *empty, kernel=kernel).shape == (0, 8)


@pytest.mark.parametrize("kernel", KERNELS)
def test_nan_is_not_hidden_and_gradients_flow(kernel: Kernel) -> None:
    values = torch.randn(1, 6, 1, 2, requires_grad=True)
    offsets = torch.full((1, 1, 1, 1, 2), 0.3, requires_grad=True)
    weights = torch.ones(1, 1, 1, 1, requires_grad=True)
    middle = torch.full((1, 1, 1, 1, 2), 0.5)
    total = deformable_sampling(values, [(2, 3)], middle, offsets, weights, kernel=kernel).square().sum()
    for gradient in torch.autograd.grad(total, (values, offsets, weights)):
        assert gradient.abs().sum() > 0
    lost = deformable_sampling(
        values.detach(), [(2, 3)], middle, offsets.detach() * float("nan"), weights, kernel=kernel
    )
    assert lost.isnan().all()


def test_half_precision_is_close() -> None:
    generator = torch.Generator().manual_seed(1)
    values = torch.randn(2, 30, 2, 8, generator=generator)
    references = torch.rand(9, 1, 1, 1, 2, generator=generator)
    offsets = torch.randn(9, 2, 1, 4, 2, generator=generator)
    weights = torch.rand(9, 2, 1, 4, generator=generator)
    source = torch.arange(9) % 2
    full = deformable_sampling(values, [(5, 6)], references, offsets, weights, source)
    for kernel in KERNELS:
        half = deformable_sampling(
            values.bfloat16(), [(5, 6)], references, offsets.bfloat16(), weights.bfloat16(), source, kernel
        )
        assert half.dtype == torch.bfloat16
        torch.testing.assert_close(half.float(), full, rtol=0, atol=0.1)
