"""Filling a network by the names of its tensors, as every golden set of a network asks."""

import hashlib

import numpy as np
import torch
from torch import nn

from benchmark.verification.checks import Comparison
from benchmark.verification.synthetic_weights import WeightsRecipe

NAMES = "names and shapes of tensors"
WEIGHTS = "SHA-256 of all weights"


def have_same_names_and_shapes(
    comparison: Comparison,
    network: nn.Module,
    shapes: dict[str, tuple[int, ...]],
    quantity: str = NAMES,
    said: str = "{elements:,} numbers, {order}",
) -> bool:
    """Whether a strict load of the official checkpoint's tensors would work; the comparison gets the differences.

    ``said`` is the note where nothing differs, in which ``elements`` and ``order`` are filled in.
    """
    own = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    names = sorted(own.keys() | shapes.keys())
    wrong = [name for name in names if own.get(name) != shapes.get(name)]
    comparison.verdicts(quantity, [name in wrong for name in names])
    elements = sum(int(np.prod(shape)) for shape in shapes.values())
    order = "in the same order" if list(own) == list(shapes) else "in another order"
    comparison.note(quantity, f"first: {wrong[0]}" if wrong else said.format(elements=elements, order=order))
    return not wrong


def fill_network(
    comparison: Comparison,
    network: nn.Module,
    recipe: WeightsRecipe,
    shapes: dict[str, tuple[int, ...]],
    recorded: str | None = None,
) -> None:
    """Give a network the weights that a golden set describes.

    Where the set has ``recorded``, the SHA-256 of names and bytes of all weights, the comparison gets whether they are
    these.
    """
    digest = hashlib.sha256()
    tensors = {}
    for name, value in recipe.state(shapes).items():
        contiguous = np.ascontiguousarray(value).reshape(shapes[name])
        digest.update(name.encode())
        digest.update(contiguous.tobytes())
        tensors[name] = torch.from_numpy(contiguous)
    network.load_state_dict(tensors, strict=True)
    if recorded is not None:
        comparison.verdicts(WEIGHTS, digest.hexdigest() != recorded)
