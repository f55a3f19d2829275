"""Frames per second and memory of the native networks: warm, synchronised, batch 1, random weights, the network alone.

Run as ``python bench/models.py``, with ``--model``, ``--device``, ``--mode`` and ``--frames`` to choose. Every line is
measured in a process of its own, so that peak memory is that line's. Scenes have ten frames, and the first is not
counted: from the second on a network remembers. On a processor the figure is for ``OMP_NUM_THREADS`` threads, from
processor time divided by them, which other work on the machine disturbs least; on a GPU it is wall time. Weights are
random, so thresholds inside the networks keep more or less than with trained ones; those of UniAD's classes are set so
that one query in a hundred becomes a track in each frame, ninety after ten frames. ``--parts`` says where the time
goes. After the first line of a model, others say how far their plans are from its.
"""

import argparse
import math
import multiprocessing
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch
from torch import nn

from adapters.models import Model, miniatures, published_model, published_models, resolve
from benchmark.machine.devices import single_precision

PUBLISHED_FPS = {"vad-tiny": 16.8, "vad-base": 4.5, "sparsedrive": 9.0, "diffusiondrive": 8.2, "uniad": 1.8}
"""As the authors give them (VAD's for UniAD); they name no hardware."""
MODES = ("float32", "bfloat16", "compiled", "bfloat16-compiled")
WARM_UP_FRAMES = {"cpu": 0, "cuda": 10}
MEASURED_FRAMES = {"cpu": 2, "cuda": 50}
FRAMES_A_SCENE = 10
TRACKED_SHARE, BORN_SCORE = 0.01, 0.4
PARTS = {
    "uniad": (
        "img_backbone",
        "img_neck",
        "pts_bbox_head.transformer.encoder",
        "pts_bbox_head.transformer.decoder",
        "seg_head",
        "motion_head",
        "occ_head",
        "planning_head",
    )
}
"""Modules that are called once a frame; what they leave of the whole is told as the rest."""


@dataclass(frozen=True, slots=True)
class Speed:
    """One line: seconds for a frame, processor seconds for a frame, peak memory in GiB, or why there is none.

    With it the first two plans, and the share of the time that each part took.
    """

    seconds: float = 0.0
    processor_seconds: float = 0.0
    peak_gib: float = 0.0
    plans: list[torch.Tensor] = field(default_factory=list)
    parts: dict[str, float] = field(default_factory=dict)
    failure: str | None = None


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


@contextmanager
def timed_parts(network: nn.Module, names: tuple[str, ...], device: torch.device) -> Iterator[dict[str, float]]:
    """Add up how long modules take, in processor time or, with waits that slow the whole, on a GPU."""
    spent = dict.fromkeys(names, 0.0)

    def now() -> float:
        if device.type != "cuda":
            return time.process_time()
        torch.cuda.synchronize()
        return time.perf_counter()

    def stopwatch(name: str) -> list[torch.utils.hooks.RemovableHandle]:
        module = network.get_submodule(name)

        def start(*_: object) -> None:
            spent[name] -= now()

        def stop(*_: object) -> None:
            spent[name] += now()

        return [module.register_forward_pre_hook(start), module.register_forward_hook(stop)]

    handles = [handle for name in names for handle in stopwatch(name)]
    try:
        yield spent
    finally:
        for handle in handles:
            handle.remove()


def model_measured(name: str, *, tiny: bool) -> Model:
    """What is measured of a name: the published network, or the small one of the same classes that stands for it."""
    if not tiny:
        return published_model(name)
    return next(small for small in miniatures().values() if name in small.small.stands_for)


def measured(name: str, device_name: str, mode: str, frames: int, parts: bool, *, tiny: bool = False) -> Speed:
    """Time and memory of one network in this process."""
    device = torch.device(device_name)
    on_gpu = device.type == "cuda"
    torch.manual_seed(0)
    model = model_measured(name, tiny=tiny)
    network: Any = model.build().eval().to(device)
    inputs = on_device(resolve(model.net.example)(model.configuration()), device)
    if name == "uniad":
        few_tracks(network, inputs)
    # A trial traces the network and spares itself the minutes of a compiler.
    backend = "eager" if tiny else "inductor"
    step = torch.compile(network, backend=backend) if mode.endswith("compiled") else network
    half = torch.autocast(device.type, torch.bfloat16, enabled=mode.startswith("bfloat16"))
    spent: dict[str, float] = {}
    seconds = processor = 0.0
    with torch.inference_mode(), single_precision(), half:
        # A compiled network is compiled anew for the second frame, the first that remembers one.
        plans = [step(inputs).plan.float().cpu() for _ in range(2 if mode.endswith("compiled") else 1)]
        for _ in range(WARM_UP_FRAMES[device.type]):
            step(inputs)
        if on_gpu:
            torch.cuda.reset_peak_memory_stats()
        with timed_parts(network, PARTS.get(name, ()) if parts else (), device) as spent:
            for frame in range(frames):
                if frame and frame % FRAMES_A_SCENE == 0:
                    before = dict(spent)
                    network.reset()
                    step(inputs)
                    spent.update(before)
                if on_gpu:
                    torch.cuda.synchronize()
                started = time.perf_counter(), time.process_time()
                outputs = step(inputs)
                if on_gpu:
                    torch.cuda.synchronize()
                seconds += time.perf_counter() - started[0]
                processor += time.process_time() - started[1]
                if frame == 0:
                    plans.append(outputs.plan.float().cpu())
    peak = torch.cuda.max_memory_allocated() if on_gpu else 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    whole = seconds if on_gpu else processor
    shares = {part: time_s / whole for part, time_s in spent.items()}
    return Speed(seconds / frames, processor / frames, peak / 2**30, plans, shares)


def measured_or_why(case: tuple[str, str, str, int, bool]) -> Speed:
    try:
        return measured(*case)
    except Exception as error:
        return Speed(failure=f"{type(error).__name__}: {(str(error).splitlines() or [''])[0][:120]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", action="append", choices=tuple(published_models()))
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu", choices=("cpu", "cuda"))
    parser.add_argument("--mode", action="append", choices=MODES)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--parts", action="store_true")
    chosen = parser.parse_args()
    frames = chosen.frames or MEASURED_FRAMES[chosen.device]
    on_gpu = chosen.device == "cuda"
    threads = torch.get_num_threads()
    hardware = torch.cuda.get_device_name() if on_gpu else f"processor, {threads} thread(s)"
    print(f"{hardware}, torch {torch.__version__}, batch 1, mean of {frames} warm frames, random weights")
    for name in chosen.model or published_models():
        first: list[torch.Tensor] = []
        for mode in chosen.mode or (MODES if on_gpu else MODES[:1]):
            with multiprocessing.get_context("spawn").Pool(1) as process:
                speed = process.apply(measured_or_why, ((name, chosen.device, mode, frames, chosen.parts),))
            if speed.failure is not None:
                print(f"{name:14s} {mode:18s} not measured: {speed.failure}")
                continue
            per_frame = speed.seconds if on_gpu else speed.processor_seconds / threads
            published = PUBLISHED_FPS.get(name)
            ratio = f"{1 / per_frame / published:6.2f} x published {published}" if published else ""
            print(
                f"{name:14s} {mode:18s} {1 / per_frame:8.3f} frames/s {1e3 * per_frame:9.1f} ms a frame "
                f"(wall {1e3 * speed.seconds:.1f}) {speed.peak_gib:6.2f} GiB peak {ratio}"
            )
            first = first or speed.plans
            if first is not speed.plans:
                apart = max(float((one - other).abs().max()) for one, other in zip(first, speed.plans))
                print(f"{'':14s} plans up to {100 * apart:.2f} cm from those of the first line")
            if speed.parts:
                rest = {"rest": 1 - sum(speed.parts.values())}
                print(" " * 14, ", ".join(f"{part} {share:.0%}" for part, share in (speed.parts | rest).items()))


if __name__ == "__main__":
    main()
