"""Calls of the network in blocks, on any device, for several requests at once."""

import contextlib
import functools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion.denoiser import DenoiserStep, TrajectoryDenoiser
from generation.diffusion.preconditioning import compute_present_features
from generation.diffusion.schedule import Denoise

PROCESSOR_ROWS: Final = 320
"""Trajectories of one network call on a processor: their features fit into its cache."""
ACCELERATOR_ROWS: Final = 4096
"""Trajectories of one network call on an accelerator. Fixed, and filled up where there are fewer, because a matrix
product's last bits depend on its shape: so an answer does not depend on who asks beside it."""


class BatchedNetwork:
    """A network at work; ``block`` trajectories make one call, filled up where fewer; ``None`` fills nothing up."""

    def __init__(
        self, denoiser: TrajectoryDenoiser, device: torch.device, block: int | None, *, conditioned: bool, dropout: bool
    ) -> None:
        """Put a network to work. ``conditioned`` tells it how vehicles move now, if it can be told."""
        self.denoiser = denoiser.to(device).train(dropout)
        self.device, self.block = device, block
        self._conditioned = conditioned and denoiser.config.conditioned
        self._dropout = dropout
        self._steps: dict[tuple[float, int], DenoiserStep] = {}

    def put(self, parts: Sequence[Tensor]) -> Tensor:
        """(B, ...) rows of all requests on the device."""
        return torch.cat(list(parts)).to(self.device)

    def present(self, previous: Sequence[Floats], sizes: Sequence[int]) -> Tensor | None:
        """(B, 4) `compute_present_features` of all rows of all requests, as the network is told them.

        (1, 4) of a request that is alone, ``None`` if the network is told nothing; ``previous`` are (3,) poses half a
        second ago, ``sizes`` the rows of each request.
        """
        if not self._conditioned:
            return None
        features = [compute_present_features(torch.from_numpy(pose.astype(np.float32)))[None] for pose in previous]
        if self.block is None and len(features) == 1:
            return self.put(features)
        return self.put([row.expand(size, -1) for row, size in zip(features, sizes, strict=True)])

    def told(self, present: Tensor | None) -> Denoise:
        """The network with what it is told (`present`): predicts the noise in the rows of all requests."""
        preconditioner = self.denoiser.preconditioner
        # On an accelerator, reading the timestep would wait for all pending work.
        kind = None if preconditioner is None or self.device.type != "cpu" else preconditioner.kind(present)
        return functools.partial(self._predict, present=present, kind=kind)

    @contextlib.contextmanager
    def inference_context(self, rngs: Sequence[np.random.Generator]) -> Iterator[None]:
        """No gradients; chance of dropout from the first request, and none of it left behind."""
        with torch.inference_mode(), torch.random.fork_rng(enabled=self._dropout):
            if self._dropout:
                torch.manual_seed(int(rngs[0].integers(2**62)))
            yield

    def _predict(self, noisy: Tensor, timestep: Tensor, *, present: Tensor | None, kind: int | None) -> Tensor:
        count, size = len(noisy), self.block or PROCESSOR_ROWS
        if self.block is not None:
            noisy, present = _pad_rows(noisy, size), None if present is None else _pad_rows(present, size)
        step = None if kind is None else self._prepare_step(timestep, present, kind)
        blocks = torch.split(noisy, size)
        # All rows are equal, so one is enough.
        alone = present is None or len(present) == 1
        moving = [present] * len(blocks) if present is None or alone else list(torch.split(present, size))
        answers = [self.denoiser(block, timestep, known, step) for block, known in zip(blocks, moving, strict=True)]
        return (answers[0] if len(answers) == 1 else torch.cat(answers))[:count]

    def _prepare_step(self, timestep: Tensor, present: Tensor | None, kind: int) -> DenoiserStep:
        """Parts of a call that need no actions; the same in every request at this timestep and of this kind."""
        key = (float(timestep), kind)
        if key not in self._steps:
            self._steps[key] = self.denoiser.step(timestep, present)
        return self._steps[key]


def parse_device(name: str) -> torch.device:
    """A device, for example ``cpu`` or ``cuda``, on which this machine can compute."""
    try:
        device = torch.device(name)
        torch.ones(1, device=device).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise InputError(
            f"this machine cannot compute on device {name!r}; use cpu, or cuda where there is a GPU"
        ) from error
    return device


def _pad_rows(rows: Tensor, size: int) -> Tensor:
    """Rows with zeros after them up to whole blocks."""
    return torch.cat([rows, rows.new_zeros(-len(rows) % size, *rows.shape[1:])])
