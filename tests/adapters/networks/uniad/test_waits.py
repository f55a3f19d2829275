"""How often a frame makes the host wait for the device: every wait leaves a graphics card without work."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from adapters.networks.uniad.model import UniAD
from tests.adapters.networks.uniad.small_uniad import frame, small_network

READS = ("cpu", "item", "numpy", "tolist", "__bool__", "__float__", "__int__", "__index__")
"""Methods of tensors that need their numbers."""
OPERATORS = ("nonzero", "_local_scalar_dense", "masked_select", "unique", "lift_fresh", "repeat_interleave.Tensor")
"""Operators whose result has a shape that the host must know, or that begin with numbers of the host."""


class _Waits(TorchDispatchMode):  # type: ignore[no-untyped-call]
    def __init__(self, found: Counter[str]) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.found = found

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = str(func).removeprefix("aten.")
        if name.startswith(OPERATORS):
            self.found[name] += 1
        elif name.startswith("index"):
            masks = [index for index in args[1] if isinstance(index, Tensor) and index.dtype == torch.bool]
            self.found["index by a mask"] += len(masks)
        return func(*args, **(kwargs or {}))


@contextmanager
def waits(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """Count what waits; on a processor nothing does, but the calls are the same."""
    found: Counter[str] = Counter()

    def counted(name: str) -> Any:
        original = getattr(Tensor, name)

        def method(self: Tensor, *args: Any, **kwargs: Any) -> Any:
            if self.device.type == "cpu" and name == "cpu":
                found["to the host"] += 1
            elif name != "cpu":
                found[name] += 1
            return original(self, *args, **kwargs)

        return method

    with monkeypatch.context() as patched, _Waits(found):
        for name in READS:
            patched.setattr(Tensor, name, counted(name))
        yield found
    for name in [name for name, count in found.items() if not count]:
        del found[name]


def after_the_images(network: UniAD, number: int, monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Waits of a frame once its images are being looked at; before, nothing is computed that could be waited for."""
    with torch.inference_mode(), waits(monkeypatch) as found:
        started = network.img_backbone.register_forward_hook(lambda *_: found.clear())
        try:
            network.predict(frame(number))
        finally:
            started.remove()
    return found


def test_a_frame_waits_twice_for_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for the cells that cameras see, once for how many tracks there are; tracks are there from frame 1 on."""
    network = small_network()
    for number in range(3):
        found = after_the_images(network, number, monkeypatch)
        assert found == {"nonzero.default": 1, "tolist": 1}, number
