"""What the plan's own eyes for the front camera begin with, in all miniatures."""

from collections.abc import Mapping
from typing import Final

from torch import Tensor

from adapters.extensions.training.front import THINGS
from adapters.extensions.training.image_encoder import RARE

OWN_EYES: Final = "front_eyes."
"""How the names of their layers begin, in all networks."""
LEARNED_BY_OTHERS: Final = {
    "img_backbone.": f"{OWN_EYES}backbone.",
    "img_neck.lateral_convs.0.conv.": f"{OWN_EYES}fine.",
    "img_neck.lateral_convs.1.conv.": f"{OWN_EYES}coarse.",
    "img_neck.fpn_convs.0.conv.": f"{OWN_EYES}joined.",
}
"""How names of layers begin that own eyes start from, and of theirs."""
SPARSE_READER: Final = "head.motion_plan_head.front_reader."
"""How the names begin of what reads their map in the sparse miniatures."""
TOLD: Final = "tell"
"""How names go on of what tells the plan of it: the numbers are those of one plan, and mean nothing to another."""


def seen_with_own_eyes(trunk: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights of a network whose plan looked at the maps of all cameras, for one with eyes of its own.

    Returns:
        The same, and what the eyes begin with: the layers that made those maps, which say of no place that anything is
        there (`adapters.extensions.training.front.things_loss`).
    """
    if any(name.startswith(OWN_EYES) for name in trunk):
        return dict(trunk)
    eyes = {
        begun + name.removeprefix(learned): value.clone()
        for name, value in trunk.items()
        for learned, begun in LEARNED_BY_OTHERS.items()
        if name.startswith(learned)
    }
    for what, least in (("weight", 0.0), ("bias", RARE)):
        joined = eyes.get(f"{OWN_EYES}joined.{what}")
        if joined is not None:
            joined[: len(THINGS)] = least
    return dict(trunk) | eyes


def eyes_of_sparse(trunk: Mapping[str, Tensor], reader: str) -> dict[str, Tensor]:
    """The eyes of the plan of a sparse miniature and what reads their map, for another miniature.

    `reader` is how the names begin of what reads the map of the front camera in the network that they are for. None
    where the weights are of another network, or their plan has no eyes of its own.
    """
    read = {
        reader + name.removeprefix(SPARSE_READER): value
        for name, value in trunk.items()
        if name.startswith(SPARSE_READER) and not name.startswith(f"{SPARSE_READER}{TOLD}")
    }
    eyes = {name: value for name, value in trunk.items() if name.startswith(OWN_EYES)}
    return eyes | read if eyes and read else {}
