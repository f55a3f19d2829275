"""What the modules of a network give, call by call, beside what those of the official code gave."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor, nn

from adapters.extensions.golden_sets.sparse_set import ModuleStatistic
from adapters.extensions.golden_sets.taps import hooked


@dataclass(frozen=True, slots=True)
class Trace:
    """Feature maps of one frame by name, and means, standard deviations, largest sizes and counts of each call."""

    maps: dict[str, list[Tensor]] = field(default_factory=dict)
    calls: dict[str, list[tuple[float, float, float, int]]] = field(default_factory=lambda: defaultdict(list))


@contextmanager
def traced(network: nn.Module, calls: list[ModuleStatistic]) -> Iterator[Trace]:
    """Record a frame of the network that runs within the context; modules that it does not have are passed over."""
    trace = Trace()
    modules = {name for name, _ in network.named_modules()}

    def keep_maps(name: str) -> tuple[str, Callable[[Any], None]]:
        return name, lambda maps: trace.maps.update({name: maps})

    def keep_statistics(name: str) -> tuple[str, Callable[[Any], None]]:
        def keep(output: Any) -> None:
            numbers = _tensor_of(output).double()
            largest = float(numbers.abs().amax()) if numbers.numel() else 0.0
            deviation = float(numbers.std(correction=0))
            trace.calls[name].append((float(numbers.mean()), deviation, largest, numbers.numel()))

        return name, keep

    named = sorted({call.module for call in calls} & modules)
    with hooked(network, [keep_maps("img_backbone"), keep_maps("img_neck"), *map(keep_statistics, named)]):
        yield trace


def _tensor_of(output: Any) -> Tensor:
    """The tensor that stands for what a module gave: of several the first, and of plans their offsets."""
    if isinstance(output, Tensor):
        return output
    first: Tensor = output[0]
    # The refinement of plans gives logits first and offsets second; the official one has it the other way round.
    return output[1] if first.ndim == 1 else first
