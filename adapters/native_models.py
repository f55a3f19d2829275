"""The networks that are written here natively: how to build each one, and what its official files are like.

One entry a model; checkpoints, planners and the speed figures all go through this list. Nothing is imported until it is
asked for.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import nn

from benchmark.errors import InputError


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
    """

    name: str
    build: Callable[[], nn.Module]
    example: Callable[[], Any]
    published_normalisation: str
    renamed: tuple[tuple[str, str], ...] = ()
    ignored: tuple[str, ...] = ()

    def expected(self) -> dict[str, torch.Tensor]:
        """Names, shapes and types of all tensors, without their memory."""
        with torch.device("meta"):
            return dict(self.build().state_dict())


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
    from adapters.vad.model import VAD
    from adapters.vad.planner import VARIANTS

    return VAD(VARIANTS[variant]())


def _vad_frame(variant: str) -> Any:
    from adapters.vad.planner import VARIANTS, example_frame

    return example_frame(VARIANTS[variant]())


def _sparse(name: str) -> nn.Module:
    # Constants are computed where the modules are first read, and need memory whatever the network is built on.
    with torch.device("cpu"):
        from adapters.sparse.planner_adapter import sparse_network
    return sparse_network(name)


def _sparse_frame(name: str) -> Any:
    from adapters.sparse.planner_adapter import VARIANTS, example_frame

    return example_frame(VARIANTS[name]())


NATIVE_MODELS: Final = {
    "vad-tiny": NativeModel("vad-tiny", lambda: _vad("vad-tiny"), lambda: _vad_frame("vad-tiny"), "bgr-mean"),
    "vad-base": NativeModel("vad-base", lambda: _vad("vad-base"), lambda: _vad_frame("vad-base"), "bgr-mean"),
    "sparsedrive": NativeModel(
        "sparsedrive", lambda: _sparse("sparsedrive"), lambda: _sparse_frame("sparsedrive"), "rgb-mean-std"
    ),
    "diffusiondrive": NativeModel(
        "diffusiondrive", lambda: _sparse("diffusiondrive"), lambda: _sparse_frame("diffusiondrive"), "rgb-mean-std"
    ),
}
