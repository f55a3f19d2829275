"""Frames per second and memory of the native networks: warm, synchronised, batch 1, random weights, the network alone.

Scenes have ten frames, and the first is not counted: from the second on a network remembers. Thresholds inside the
networks keep more or less than with trained weights; those of UniAD's classes are set so that one query in a hundred
becomes a track in each frame, ninety after ten frames.
"""

import math
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import torch

from adapters.models import Model, miniatures, published_model, resolve
from benchmark.machine.devices import single_precision

PUBLISHED_FPS = {"vad-tiny": 16.8, "vad-base": 4.5, "sparsedrive": 9.0, "diffusiondrive": 8.2, "uniad": 1.8}
"""As the authors give them (VAD's for UniAD); they name no hardware."""
WARM_UP_FRAMES = {"cpu": 0, "cuda": 10}
MEASURED_FRAMES = {"cpu": 2, "cuda": 50}
FRAMES_A_SCENE = 10
TRACKED_SHARE, BORN_SCORE = 0.01, 0.4


@dataclass(frozen=True, slots=True)
class Speed:
    """Seconds and processor seconds for a frame, peak memory in GiB."""

    seconds: float
    processor_seconds: float
    peak_gib: float


def on_device(inputs: Any, device: torch.device) -> Any:
    """The images of a frame on the device; the rest stays where a planner leaves it."""
    images = next(each.name for each in fields(inputs) if each.name == "images")
    return replace(inputs, **{images: getattr(inputs, images).to(device)})


def few_tracks(network: Any, inputs: Any) -> None:
    """Set the class thresholds of UniAD by what it says of a frame; random ones make a track of every query."""
    bias = network.pts_bbox_head.cls_branches[-1][-1].bias
    with torch.inference_mode(), single_precision():
        bias.fill_(-99.0)
        logits = network.predict(inputs).detections.class_logits[-1] + 99.0
        highest = logits.quantile(1 - TRACKED_SHARE / logits.shape[-1], 0)
        bias.copy_(math.log(BORN_SCORE / (1 - BORN_SCORE)) - highest)
        network.reset()


def model_measured(name: str, *, tiny: bool) -> Model:
    """What is measured of a name: the published network, or the small one of the same classes that stands for it."""
    if not tiny:
        return published_model(name)
    return next(small for small in miniatures().values() if name in small.small.stands_for)


def ready(name: str, device: torch.device, mode: str, *, tiny: bool) -> tuple[Any, Callable[[], Any]]:
    """A network with random weights, and what plans one frame."""
    torch.manual_seed(0)
    model = model_measured(name, tiny=tiny)
    network: Any = model.build().eval().to(device)
    inputs = on_device(resolve(model.net.example)(model.configuration()), device)
    if name == "uniad":
        few_tracks(network, inputs)
    # A trial traces the network and spares itself the minutes of a compiler.
    backend = "eager" if tiny else "inductor"
    step = torch.compile(network, backend=backend) if mode.endswith("compiled") else network

    def frame() -> Any:
        half = torch.autocast(device.type, torch.bfloat16, enabled=mode.startswith("bfloat16"))
        with torch.inference_mode(), single_precision(), half:
            return step(inputs)

    # A compiled network is compiled anew for the second frame, the first that remembers one.
    for _ in range(2 if mode.endswith("compiled") else 1):
        frame()
    return network, frame


def measured(name: str, device_name: str, mode: str, frames: int, *, tiny: bool = False) -> Speed:
    """Time and memory of one network in this process."""
    device = torch.device(device_name)
    network, step = ready(name, device, mode, tiny=tiny)
    wait: Callable[[], None] = torch.cuda.synchronize if device.type == "cuda" else lambda: None
    for _ in range(WARM_UP_FRAMES[device.type]):
        step()
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats()
    seconds = processor = 0.0
    for frame in range(frames):
        if frame and frame % FRAMES_A_SCENE == 0:
            network.reset()
            step()
        wait()
        started = time.perf_counter(), time.process_time()
        step()
        wait()
        seconds += time.perf_counter() - started[0]
        processor += time.process_time() - started[1]
    resident = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak = torch.cuda.max_memory_allocated() if device.type == "cuda" else resident
    return Speed(seconds / frames, processor / frames, peak / 2**30)
