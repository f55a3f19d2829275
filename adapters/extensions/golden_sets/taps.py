"""What inner modules of a network give while it runs, under the names of golden sets."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from torch import Tensor, nn


@contextmanager
def hooked(network: nn.Module, hooks: Iterable[tuple[str, Callable[[Any], None]]]) -> Iterator[None]:
    """Hand on the outputs of modules, by their names, of the network that runs within the context."""
    handles = []
    try:
        for name, keep in hooks:

            def hook(_module: nn.Module, _inputs: object, output: Any, keep: Callable[[Any], None] = keep) -> None:
                keep(output)

            handles.append(network.get_submodule(name).register_forward_hook(hook))
        yield
    finally:
        for handle in handles:
            handle.remove()


@contextmanager
def tapped(network: nn.Module, head: str = "", parts: Iterable[str] = ()) -> Iterator[dict[str, Tensor]]:
    """Feature maps of images, and what `parts` of a `head` give, of the network that runs within the context.

    Tensors come by the names of the sets.
    """
    taps: dict[str, Tensor] = {}

    def levels(name: str) -> tuple[str, Callable[[Any], None]]:
        return f"img_{name}", lambda maps: taps.update({f"{name}{level}": each for level, each in enumerate(maps)})

    def tokens(name: str) -> tuple[str, Callable[[Any], None]]:
        return f"{head}.{name}", lambda states: taps.update({name: states})

    with hooked(network, [levels("backbone"), levels("neck"), *map(tokens, parts)]):
        yield taps
