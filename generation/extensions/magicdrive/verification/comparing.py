"""`verify model --model magicdrive`: the network, its guidance and its sampler against numbers of the official code."""

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.geometry import Floats
from benchmark.machine.devices import single_precision
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.filled_networks import NAMES, fill, same_names_and_shapes
from benchmark.verification.golden import GoldenArrays, GoldenFolder, GoldenSet
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.model import MagicDriveDiT
from generation.extensions.magicdrive.sampling import timesteps
from generation.extensions.magicdrive.verification.golden_set import MagicDriveSet
from generation.extensions.magicdrive.verification.quantities import (
    ENCODERS,
    EVALUATIONS,
    HALF_PRECISION,
    LARGE,
    SAMPLES,
    SCHEDULES,
    Clips,
)

FILES: Final = ("manifest.json", "inputs.npz", "outputs.npz")
OF_SPREAD: Final = 1e-3
"""Largest error as a share of the golden standard deviation."""
EVALUATION: Final = 1e-4
"""Largest error of one evaluation, whatever the spread."""
SAMPLE: Final = 1e-3
"""Largest error of four steps."""
TIMESTEP: Final = 1e-3
UNCORRELATED: Final = 1e-3
"""One less the correlation: official numbers in bfloat16 are themselves no more certain."""
PUBLISHED: Final = "names and shapes of tensors, published size"


def verify_magicdrive(golden: Path, device: str = "cpu") -> list[Check]:
    """Compare the network with a golden set, its folder or the one above it: one check for each quantity.

    There are those of names alone if names or shapes differ, since weights cannot be filled then. Tolerances are
    those of single precision.
    """
    below = golden / "dev"
    folder = below if (below / FILES[0]).is_file() else golden
    return GoldenSet("MagicDriveDiT", FILES, (partial(_compare_network, device=device),), usual="dev").verify(folder)


def _compare_network(comparison: Comparison, folder: GoldenFolder, device: str) -> None:
    stored = MagicDriveSet.read(folder)
    if stored.published_shapes is not None:
        published = _without_memory(MagicDriveConfig.full())
        same_names_and_shapes(comparison, published, stored.published_shapes, PUBLISHED, "{elements:,} numbers")
    if not same_names_and_shapes(comparison, _without_memory(stored.config), stored.shapes):
        return
    network = MagicDriveDiT(stored.config).eval()
    fill(comparison, network, stored.recipe, stored.shapes)
    clips = Clips(network.to(device), _rounded(network).to(device), stored)
    with single_precision(), torch.inference_mode():
        _compare_schedules(comparison, stored)
        _compare_stored(comparison, clips)
        if stored.inner is not None:
            _compare_inner(comparison, clips, stored.inner)
    known = {**ENCODERS, **EVALUATIONS, **SAMPLES, **SCHEDULES, **HALF_PRECISION, "sample_firstframe_mask": None}
    if unknown := sorted(stored.outputs.names - known.keys()):
        comparison.note(NAMES, f"not compared: {', '.join(unknown)}")


def _without_memory(config: MagicDriveConfig) -> MagicDriveDiT:
    """A network that has names and shapes only."""
    with torch.device("meta"):
        return MagicDriveDiT(config)


def _rounded(network: MagicDriveDiT) -> MagicDriveDiT:
    """The network that the published pipeline would run, computed exactly."""
    rounded = MagicDriveDiT(replace(network.config, rounded=True)).eval()
    rounded.load_state_dict(copy.deepcopy(network).to(torch.bfloat16).float().state_dict())
    return rounded


def _compare_schedules(comparison: Comparison, stored: MagicDriveSet) -> None:
    for entry in stored.schedules:
        size, wanted = (entry.height, entry.width, entry.num_frames), np.asarray(entry.timesteps, np.float64)
        rounded = entry.kwargs_dtype == "bfloat16"
        ours = timesteps(*size, len(wanted), rounded=rounded)
        quantity = f"timesteps ({'size rounded to bfloat16' if rounded else 'exact size'})"
        comparison.numbers(quantity, ours.numpy(), wanted, TIMESTEP, where=" x ".join(map(str, size)))


def _compare_stored(comparison: Comparison, clips: Clips) -> None:
    golden = clips.golden.outputs
    tables = ((ENCODERS, EVALUATION), (EVALUATIONS, EVALUATION), (SAMPLES, SAMPLE), (SCHEDULES, TIMESTEP))
    compared = 0
    for table, allowed in tables:
        for name, compute in table.items():
            if name in golden.names:
                _compare(comparison, golden, name, compute(clips), allowed)
                compared += 1
    for name, compute in HALF_PRECISION.items():
        if name in golden.names:
            ours = _numbers(compute(clips))
            wanted = golden.floats(name, *ours.shape)
            correlation = float(np.corrcoef(ours.ravel(), wanted.ravel())[0, 1])
            comparison.errors(f"{name} (1 - correlation)", np.array([1 - correlation]), UNCORRELATED)
            compared += 1
    if not compared:
        raise ValueError("it stores no quantity of MagicDriveDiT")


def _compare(comparison: Comparison, golden: GoldenArrays, name: str, ours: Tensor, allowed: float) -> None:
    values = _numbers(ours)
    wanted = golden.floats(name, *values.shape)
    spread = float(wanted.std())
    if name in LARGE:
        comparison.numbers(f"{name} (of its spread)", values / spread, wanted / spread, allowed)
    else:
        comparison.numbers(name, values, wanted, min(allowed, OF_SPREAD * spread))


def _compare_inner(comparison: Comparison, clips: Clips, stored: GoldenArrays) -> None:
    """Compare the blocks in one evaluation of clip A; the same tolerance, since it is the same evaluation."""
    with _tapped(clips.network, stored.names) as taps:
        clips.forward("A")
    views = clips.network.config.views
    for name in sorted(stored.names & taps.keys()):
        tokens = taps[name][0].expand(views, -1, -1, -1)
        shaped = tokens if name == "before_proj" else tokens.flatten(1, 2)
        _compare(comparison, stored, name, shaped, EVALUATION)
    unknown = sorted(stored.names - taps.keys())
    if unknown:
        comparison.note(NAMES, f"not compared in {stored.path.name}: {', '.join(unknown)}")


@contextmanager
def _tapped(network: MagicDriveDiT, names: frozenset[str]) -> Iterator[dict[str, Tensor]]:
    """Collect outputs of modules; ``.skip`` after a control block's name is what it hands to the base stream."""
    taps: dict[str, Tensor] = {}

    def keep(name: str) -> Callable[[nn.Module, object, Tensor], None]:
        return lambda _module, _inputs, output: taps.__setitem__(name, output)

    modules = dict(network.named_modules())
    handles = []
    try:
        for name in names:
            place = name.replace(".skip", ".after_proj")
            if place in modules:
                handles.append(modules[place].register_forward_hook(keep(name)))
        yield taps
    finally:
        for handle in handles:
            handle.remove()


def _numbers(tensor: Tensor) -> Floats:
    numbers: Floats = tensor.double().cpu().numpy()
    return numbers
