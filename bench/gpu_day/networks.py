"""Pieces about the five networks: speed and memory, and whether a GPU says what a processor says.

Speed is of the network alone: warm, batch 1, random weights. Scenes have ten frames, and the first is not counted: from
the second on a network remembers. Thresholds inside the networks keep more or less than with trained weights; those of
UniAD's classes are set so that one query in a hundred becomes a track in each frame, ninety after ten frames.
"""

import copy
import math
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import Any, Final

import torch

from adapters.extensions.golden_sets.models import verify_model
from adapters.models import miniatures, published_model, resolve
from bench.gpu_day.pieces import Piece, Setting, mean_seconds
from benchmark.machine.devices import single_precision

NETWORKS: Final = ("uniad", "vad-base", "vad-tiny", "sparsedrive", "diffusiondrive")
MODES: Final = ("float32", "bfloat16", "compiled")
WARM_UP_FRAMES, MEASURED_FRAMES = 10, 50
"""On a GPU."""
FRAMES_A_SCENE: Final = 10
COMPARED_FRAMES: Final = 3
TRACKED_SHARE, BORN_SCORE = 0.01, 0.4


def on_device(inputs: Any, device: str) -> Any:
    """The images of a frame on the device; the rest stays where a planner leaves it."""
    images = next(field.name for field in fields(inputs) if field.name == "images")
    return replace(inputs, **{images: getattr(inputs, images).to(device)})


def limit_tracks(network: Any, inputs: Any) -> None:
    """Set the class thresholds of UniAD by what it says of a frame; random ones make a track of every query."""
    bias = network.pts_bbox_head.cls_branches[-1][-1].bias
    with torch.inference_mode(), single_precision():
        bias.fill_(-99.0)
        logits = network.predict(inputs).detections.class_logits[-1] + 99.0
        highest = logits.quantile(1 - TRACKED_SHARE / logits.shape[-1], 0)
        bias.copy_(math.log(BORN_SCORE / (1 - BORN_SCORE)) - highest)
        network.reset()


def build(name: str, device: str, *, tiny: bool) -> tuple[Any, Any]:
    """A network with random weights, and a frame: the published one, or the small one of the same classes."""
    torch.manual_seed(0)
    small = (candidate for candidate in miniatures().values() if name in candidate.small.stands_for)
    model = next(small) if tiny else published_model(name)
    network: Any = model.build().eval().to(device)
    inputs = on_device(resolve(model.net.example)(model.configuration()), device)
    if name == "uniad":
        limit_tracks(network, inputs)
    return network, inputs


def ready(setting: Setting, name: str, mode: str) -> tuple[Any, Callable[[], Any]]:
    """A network with random weights, and what plans one frame."""
    network, inputs = build(name, setting.device, tiny=setting.tiny)
    # A trial traces the network and spares itself the minutes of a compiler.
    backend = "eager" if setting.tiny else "inductor"
    step = torch.compile(network, backend=backend) if mode.endswith("compiled") else network

    def frame() -> Any:
        half = torch.autocast(torch.device(setting.device).type, torch.bfloat16, enabled=mode.startswith("bfloat16"))
        with torch.inference_mode(), single_precision(), half:
            return step(inputs)

    # A compiled network is compiled anew for the second frame, the first that remembers one.
    for _ in range(2 if mode.endswith("compiled") else 1):
        frame()
    return network, frame


def speed(setting: Setting, *, name: str, mode: str) -> dict[str, Any]:
    """Frames per second and peak memory of one network."""
    network, frame = ready(setting, name, mode)
    frames = 2 if setting.tiny or not setting.on_gpu else MEASURED_FRAMES

    def begin_a_scene(number: int) -> None:
        if number and number % FRAMES_A_SCENE == 0:
            network.reset()
            frame()

    for _ in range(WARM_UP_FRAMES if setting.on_gpu else 0):
        frame()
    seconds, peak = mean_seconds(setting, frame, frames, before=begin_a_scene)
    return {"frames_per_s": 1 / seconds, "ms": 1e3 * seconds, "frames": frames, **peak}


def describe_speed(figures: dict[str, Any]) -> str:
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
            "against": "outputs of the official code",
            "quantities": len(checks),
            "outside": sum(not check.ok for check in checks),
            "worst": worst.quantity,
            "error": worst.error,
            "tolerance": worst.tolerance,
        }
    network, inputs = build(name, "cpu", tiny=True)
    plans = []
    for place in ("cpu", setting.device):
        twin = copy.deepcopy(network).to(place)
        with torch.inference_mode(), single_precision():
            plans.append([twin(on_device(inputs, place)).plan.float().cpu() for _ in range(COMPARED_FRAMES)])
    apart = max(float((one - other).abs().max()) for one, other in zip(*plans, strict=True))
    against = "the processor, random weights, size of the miniature"
    return {"against": against, "frames": COMPARED_FRAMES, "plan_m": apart}


def describe_agreement(figures: dict[str, Any]) -> str:
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
        Piece(
            f"{name}-agreement",
            "does it say the same on the device?",
            partial(agreement, name=name),
            describe_agreement,
        )
        for name in reversed(NETWORKS)
    ]
    speeds = [
        Piece(f"{name}-{mode}", "frames per second and memory", partial(speed, name=name, mode=mode), describe_speed)
        for mode in MODES
        for name in reversed(NETWORKS)
    ]
    return (*agreements, *speeds)
