"""How far rounding alone moves what our network gives: it runs again with images that hardly differ, and other threads.

Networks with random weights amplify rounding from frame to frame. A quantity that is past its tolerance by no more than
such a change moves it says nothing about the network.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Final

import torch
from torch import Tensor, nn

from benchmark.verification.checks import ROUNDING, Check, Comparison

IMAGE_NOISE: Final = 1e-7
"""What images are changed by: about the last bit of numbers around one, which normalised images are."""
NOTABLE: Final = 0.5
"""A quantity that rounding moves by more than this share of its tolerance is told of."""


@dataclass(frozen=True, slots=True)
class Run:
    """One way of running a network while it is compared; images are changed by `image_noise`."""

    comparison: Comparison = field(default_factory=Comparison)
    image_noise: float = 0.0
    threads: int | None = None

    @contextmanager
    def varied(self, network: Any) -> Iterator[None]:
        """Run a network, which has an ``img_backbone``, so within the context."""
        generator, usual = torch.Generator().manual_seed(0), torch.get_num_threads()

        def changed(_module: nn.Module, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
            images = inputs[0]
            noise = torch.randn(images.shape, generator=generator).to(images)
            return (images + self.image_noise * noise, *inputs[1:])

        handle = network.img_backbone.register_forward_pre_hook(changed) if self.image_noise else None
        try:
            torch.set_num_threads(self.threads or usual)
            yield
        finally:
            torch.set_num_threads(usual)
            if handle is not None:
                handle.remove()


def other_threads() -> int:
    """Another number of threads than the present one."""
    return 2 if torch.get_num_threads() == 1 else 1


def with_own_rounding(verify: Callable[[Run], Sequence[Check]]) -> list[Check]:
    """Checks of the plain run, each with the larger of the two movements by the network's own rounding.

    Notes name the movements of those that are past their tolerance, and of those that rounding moves by half of it or
    more.
    """
    plain, images, threads = Run(), Run(image_noise=IMAGE_NOISE), Run(threads=other_threads())
    for run in (plain, images, threads):
        run.comparison.remembers = True
    checks = list(verify(plain))
    verify(images)
    verify(threads)
    by_images = plain.comparison.moved_by(images.comparison)
    by_threads = plain.comparison.moved_by(threads.comparison)
    return [_told(check, by_images.get(check.quantity, 0.0), by_threads.get(check.quantity, 0.0)) for check in checks]


def _told(check: Check, by_images: float, by_threads: float) -> Check:
    moved = replace(check, moved=max(by_images, by_threads))
    assert moved.moved is not None
    if moved.ok and moved.moved <= NOTABLE * moved.tolerance:
        return moved
    said = (
        f"images changed by {IMAGE_NOISE:g} move it by {by_images:.3g}, another number of threads by {by_threads:.3g}"
    )
    verdict = f"{ROUNDING}: " if moved.rounding else ""
    return replace(moved, note="; ".join(part for part in (f"{verdict}{said}", moved.note) if part))
