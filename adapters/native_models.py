"""The networks that are written here natively: how to build each one, and what its official files are like.

One entry a model; checkpoints, planners and the speed figures all go through this list. Nothing is imported until it is
asked for.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import nn

from benchmark.errors import InputError

MOTION_ANCHORS: Final = "motion_head.anchors"
"""UniAD's typical forecasts, (groups, modes, steps, 2) metres."""


@dataclass(frozen=True, slots=True)
class NativeModel:
    """One network with a fixed configuration.

    Attributes:
        name: What ``--model`` takes.
        build: Makes the network with random weights, on whatever device is the default one.
        example: Makes inputs of one key frame, the same every time, on the processor.
        published_normalisation: What the official weights were trained with (`adapters.camera_inputs.NORMALISATIONS`).
        renamed: Patterns and replacements for tensor names that official files have under an older name.
        ignored: Patterns of tensor names that official files may have and the network does not need.
        fitted: Makes the network for tensors of given shapes by name, where official files differ in theirs.
        anchors: Tensor of the network that official checkpoints lack, because it is published in a file of its own
            (`adapters.checkpoints.motion_anchors`).
    """

    name: str
    build: Callable[[], nn.Module]
    example: Callable[[], Any]
    published_normalisation: str
    renamed: tuple[tuple[str, str], ...] = ()
    ignored: tuple[str, ...] = ()
    fitted: Callable[[Mapping[str, Sequence[int]]], nn.Module] | None = None
    anchors: str | None = None

    def expected(self, shapes: Mapping[str, Sequence[int]] | None = None) -> dict[str, torch.Tensor]:
        """Names, shapes and types of all tensors, without their memory.

        Args:
            shapes: Of the tensors that the network is for, by name.

        Returns:
            By name, in the network's order.
        """
        with torch.device("meta"):
            network = self.build() if self.fitted is None or shapes is None else self.fitted(shapes)
            return dict(network.state_dict())


def native_model(name: str) -> NativeModel:
    """A model by name.

    Args:
        name: For example ``vad-tiny``.

    Returns:
        The model.

    Raises:
        InputError: If there is none of that name.
    """
    if name not in NATIVE_MODELS:
        raise InputError(f"{name!r} is no model with weights; those are {', '.join(NATIVE_MODELS)}")
    return NATIVE_MODELS[name]


def _vad(variant: str) -> nn.Module:
    from adapters.networks.vad.model import VAD
    from adapters.networks.vad.planner import VARIANTS

    return VAD(VARIANTS[variant]())


def _vad_frame(variant: str) -> Any:
    from adapters.networks.vad.planner import VARIANTS, example_frame

    return example_frame(VARIANTS[variant]())


def _sparse(name: str) -> nn.Module:
    # Constants are computed where the modules are first read, and need memory whatever the network is built on.
    with torch.device("cpu"):
        from adapters.networks.sparse.planner import sparse_network
    return sparse_network(name)


def _sparse_frame(name: str) -> Any:
    from adapters.networks.sparse.planner import VARIANTS, example_frame

    return example_frame(VARIANTS[name]())


def _uniad(shapes: Mapping[str, Sequence[int]]) -> nn.Module:
    # Constants are computed where the modules are first read, and need memory whatever the network is built on.
    with torch.device("cpu"):
        from adapters.networks.uniad.config import UniADConfig
        from adapters.networks.uniad.model import UniAD
    return UniAD(UniADConfig.base_of(shapes), stores_anchors=True)


def _uniad_frame() -> Any:
    from adapters.networks.uniad.config import UniADConfig
    from adapters.networks.uniad.planner import example_frame

    return example_frame(UniADConfig.base())


NATIVE_MODELS: Final = {
    "vad-tiny": NativeModel("vad-tiny", lambda: _vad("vad-tiny"), lambda: _vad_frame("vad-tiny"), "bgr-mean"),
    "vad-base": NativeModel("vad-base", lambda: _vad("vad-base"), lambda: _vad_frame("vad-base"), "bgr-mean"),
    "sparsedrive": NativeModel(
        "sparsedrive", lambda: _sparse("sparsedrive"), lambda: _sparse_frame("sparsedrive"), "rgb-mean-std"
    ),
    "diffusiondrive": NativeModel(
        "diffusiondrive", lambda: _sparse("diffusiondrive"), lambda: _sparse_frame("diffusiondrive"), "rgb-mean-std"
    ),
    "uniad": NativeModel(
        "uniad",
        lambda: _uniad({}),
        _uniad_frame,
        "bgr-mean",
        fitted=_uniad,
        anchors=MOTION_ANCHORS,
        renamed=((r"\.conv(\d)_offset\.", r".conv\1.conv_offset."),),
        # Left over from a rewrite of the official code, whose authors say that nothing reads them.
        ignored=(
            r"^bbox_size_fc\.",
            r"^pts_bbox_head\.query_embedding\.",
            r"^pts_bbox_head\.transformer\.reference_points\.",
        ),
    ),
}
