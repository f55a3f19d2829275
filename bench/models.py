"""Frames per second and memory of the native networks: warm, synchronised, batch 1, random weights, the network alone.

Run as ``python bench/models.py``, with ``--model``, ``--device``, ``--mode`` and ``--frames`` to choose. Every line is
measured in a process of its own, so that peak memory is that line's. The first frame of a scene is not counted: from
the second on a network remembers. On a processor the figure is for ``OMP_NUM_THREADS`` threads, from processor time
divided by them, which other work on the machine disturbs least; on a GPU it is wall time. Weights are random, so
thresholds inside the networks keep more or less than with trained ones.
"""

import argparse
import multiprocessing
import resource
import sys
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch

from adapters.devices import single_precision
from adapters.native_models import NATIVE_MODELS, native_model

PUBLISHED_FPS = {"vad-tiny": 16.8, "vad-base": 4.5, "sparsedrive": 9.0, "diffusiondrive": 8.2}
"""As the authors give them; they name no hardware."""
MODES = ("float32", "bfloat16", "compiled", "bfloat16-compiled")
WARM_UP_FRAMES = {"cpu": 0, "cuda": 10}
MEASURED_FRAMES = {"cpu": 2, "cuda": 50}


@dataclass(frozen=True, slots=True)
class Speed:
    """One line: seconds for a frame, processor seconds for a frame, peak memory in GiB, or why there is none."""

    seconds: float = 0.0
    processor_seconds: float = 0.0
    peak_gib: float = 0.0
    failure: str | None = None


def on_device(inputs: Any, device: torch.device) -> Any:
    """The images of a frame on the device; the rest stays where a planner leaves it."""
    images = next(field.name for field in fields(inputs) if field.name == "images")
    return replace(inputs, **{images: getattr(inputs, images).to(device)})


def measured(name: str, device_name: str, mode: str, frames: int) -> Speed:
    """Time and memory of one network in this process."""
    device = torch.device(device_name)
    on_gpu = device.type == "cuda"
    torch.manual_seed(0)
    model = native_model(name)
    network = model.build().eval().to(device)
    inputs = on_device(model.example(), device)
    step = torch.compile(network) if mode.endswith("compiled") else network
    half = torch.autocast(device.type, torch.bfloat16, enabled=mode.startswith("bfloat16"))
    with torch.inference_mode(), single_precision(), half:
        # A compiled network is compiled anew for the second frame, the first that remembers one.
        for _ in range(1 + max(WARM_UP_FRAMES[device.type], 2 if mode.endswith("compiled") else 0)):
            step(inputs)
        if on_gpu:
            torch.cuda.synchronize()
            torch.cuda.reset_peak_memory_stats()
        started = time.perf_counter(), time.process_time()
        for _ in range(frames):
            step(inputs)
            if on_gpu:
                torch.cuda.synchronize()
        seconds, processor = time.perf_counter() - started[0], time.process_time() - started[1]
    peak = torch.cuda.max_memory_allocated() if on_gpu else 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Speed(seconds / frames, processor / frames, peak / 2**30)


def measured_or_why(case: tuple[str, str, str, int]) -> Speed:
    try:
        return measured(*case)
    except Exception as error:
        return Speed(failure=f"{type(error).__name__}: {(str(error).splitlines() or [''])[0][:120]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", action="append", choices=tuple(NATIVE_MODELS))
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu", choices=("cpu", "cuda"))
    parser.add_argument("--mode", action="append", choices=MODES)
    parser.add_argument("--frames", type=int)
    chosen = parser.parse_args()
    frames = chosen.frames or MEASURED_FRAMES[chosen.device]
    on_gpu = chosen.device == "cuda"
    threads = torch.get_num_threads()
    hardware = torch.cuda.get_device_name() if on_gpu else f"processor, {threads} thread(s)"
    print(f"{hardware}, torch {torch.__version__}, batch 1, mean of {frames} warm frames, random weights")
    for name in chosen.model or NATIVE_MODELS:
        for mode in chosen.mode or (MODES if on_gpu else MODES[:1]):
            with multiprocessing.get_context("spawn").Pool(1) as process:
                speed = process.apply(measured_or_why, ((name, chosen.device, mode, frames),))
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


if __name__ == "__main__":
    main()
