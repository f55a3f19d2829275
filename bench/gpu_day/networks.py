"""Pieces about the five networks: speed and memory, and whether a GPU says what a processor says."""

import copy
from functools import partial
from typing import Any, Final

import torch

from adapters.extensions.golden_sets.models import verify_model
from adapters.models import resolve
from bench.gpu_day.network_speed import MEASURED_FRAMES, few_tracks, measured, model_measured, on_device
from bench.gpu_day.pieces import Piece, Setting, with_random_weights
from benchmark.machine.devices import single_precision

NETWORKS: Final = ("uniad", "vad-base", "vad-tiny", "sparsedrive", "diffusiondrive")
MODES: Final = ("float32", "bfloat16", "compiled")
COMPARED_FRAMES: Final = 3


def speed(setting: Setting, *, name: str, mode: str) -> dict[str, Any]:
    """Frames per second and peak memory of one network, with random weights."""
    kind = torch.device(setting.device).type
    frames = 2 if setting.tiny else MEASURED_FRAMES[kind]
    line = measured(name, setting.device, mode, frames, tiny=setting.tiny)
    seconds = line.seconds if setting.on_gpu else line.processor_seconds
    return with_random_weights(line.peak_gib, frames, frames_per_s=1 / seconds, ms=1e3 * seconds)


def speed_said(figures: dict[str, Any]) -> str:
    """For people."""
    return (
        f"{figures['frames_per_s']:.2f} frames/s ({figures['ms']:.1f} ms), {figures['peak_gib']:.2f} GiB peak, mean of "
        f"{figures['frames']} frames, {figures['weights']} weights"
    )


def agreement(setting: Setting, *, name: str) -> dict[str, Any]:
    """How far a network's numbers on the device are from those it should have.

    Against numbers of the official code where they are given (`verify model`), else between processor and device, with
    random weights in the size of the miniature.
    """
    golden = None if setting.golden is None else setting.golden / name.replace("-", "_")
    if golden is not None and golden.is_dir():
        checks = verify_model(name, golden, setting.device)
        worst = max(checks, key=lambda check: check.error / check.tolerance if check.tolerance else check.error)
        return {
            "against": "numbers of the official code",
            "quantities": len(checks),
            "outside": sum(not check.ok for check in checks),
            "worst": worst.quantity,
            "error": worst.error,
            "tolerance": worst.tolerance,
        }
    here, there = _plans(name, setting.device)
    apart = max(float((one - other).abs().max()) for one, other in zip(here, there, strict=True))
    return {"against": "the processor, random weights, size of the miniature", "frames": len(here), "plan_m": apart}


def _plans(name: str, device: str) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Plans of the same network and frames on the processor and on a device."""
    torch.manual_seed(0)
    model = model_measured(name, tiny=True)
    network: Any = model.build().eval()
    inputs = resolve(model.net.example)(model.configuration())
    if name == "uniad":
        few_tracks(network, inputs)
    plans = []
    for place in ("cpu", device):
        twin, where = copy.deepcopy(network).to(place), torch.device(place)
        with torch.inference_mode(), single_precision():
            plans.append([twin(on_device(inputs, where)).plan.float().cpu() for _ in range(COMPARED_FRAMES)])
    return plans[0], plans[1]


def agreement_said(figures: dict[str, Any]) -> str:
    """For people."""
    if "plan_m" in figures:
        return (
            f"plans {figures['plan_m']:.2g} m apart at most in {figures['frames']} frames; against {figures['against']}"
        )
    return (
        f"{figures['outside']} of {figures['quantities']} quantities outside; worst {figures['worst']}: "
        f"{figures['error']:.2g} of {figures['tolerance']:.2g}; against {figures['against']}"
    )


def network_pieces() -> tuple[Piece, ...]:
    """All of them, the quick ones first."""
    agreements = [
        Piece(f"{name}-agreement", "does it say the same on the device?", partial(agreement, name=name), agreement_said)
        for name in reversed(NETWORKS)
    ]
    speeds = [
        Piece(f"{name}-{mode}", "frames per second and memory", partial(speed, name=name, mode=mode), speed_said)
        for mode in MODES
        for name in reversed(NETWORKS)
    ]
    return (*agreements, *speeds)
