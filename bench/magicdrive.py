"""Seconds and memory of MagicDriveDiT's transformer, with random weights, and where the time goes.

Run as ``python bench/magicdrive.py``: on a GPU the published network on a scene of 241 frames at 224x400 in bfloat16,
on a processor a network of reduced size in single precision; ``--mode``, ``--size``, ``--frames``, ``--boxes``,
``--words`` and ``--evaluations`` choose. Every line is measured in a process of its own, so that peak memory is that
line's. Times are of whole evaluations after warming up, synchronised; on a processor they are processor time. A scene
is 30 steps with two evaluations each and, once, the encoders of both branches; the video decoder has a line of its own,
the text encoder (0.01 % of the operations) none. Operations are counted by formula
(``generation/extensions/magicdrive/cost.py``).
"""

import argparse
import multiprocessing
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch
from torch import Tensor, nn

from generation.extensions.magicdrive.autoencoder import DIFFUSERS, VideoDecoder
from generation.extensions.magicdrive.conditions import TEXT_TOKENS, Conditions, TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.cost import Operations, Workload, operations
from generation.extensions.magicdrive.guidance import GuidedModel
from generation.extensions.magicdrive.latents import LatentSize
from generation.extensions.magicdrive.model import MagicDriveDiT

STEPS = 30
PUBLISHED_SECONDS = 395.0
"""The paper's rendering time of a scene, decoder included, on four L20."""
REDUCED = replace(MagicDriveConfig.full(), hidden=576, heads=8, depth=2, control_depth=1)
TINY = replace(REDUCED, hidden=144, heads=2)
"""For a trial of `bench/gpu.py`: the same classes in a second."""
MODES = ("plain", "compiled", "kept", "together", "compiled-kept", "decoder")
SMALL_DECODER = (32, 32, 32, 32)
"""Channels on a processor; the published ones are the default of the class."""
PARTS = ("attn", "cross_attn", "cross_view_attn", "mlp")


@dataclass(frozen=True, slots=True)
class Job:
    """What one line measures."""

    device: str
    mode: str
    frames: int
    height: int
    width: int
    boxes: int
    words: int
    evaluations: int
    tiny: bool = False

    @property
    def on_gpu(self) -> bool:
        """Whether it runs on a GPU."""
        return self.device.startswith("cuda")

    @property
    def config(self) -> MagicDriveConfig:
        """Sizes of the network."""
        if self.tiny:
            return TINY
        return MagicDriveConfig.full() if self.on_gpu else REDUCED

    @property
    def map_cells(self) -> int:
        """Cells along a side of the map, which is finer for larger images."""
        return 200 if self.height <= 224 else 400

    def count(self, *, as_published: bool) -> Operations:
        """Operations by formula."""
        size = LatentSize.of(self.frames, self.height, self.width, self.config.rows_multiple)
        clip = Workload(self.frames, size, self.words + 1, self.boxes, (self.map_cells, self.map_cells))
        return operations(self.config, clip, as_published=as_published)


@dataclass(frozen=True, slots=True)
class Line:
    """Seconds of evaluating both branches and of encoding them, peak GiB, share by part; or why there is none."""

    seconds: float = 0.0
    encoding: float = 0.0
    peak_gib: float = 0.0
    parts: dict[str, float] = field(default_factory=dict)
    failure: str | None = None


def random_conditions(job: Job) -> Conditions:
    """Random numbers of the right sizes: time does not depend on them."""
    config, views, frames = job.config, job.config.views, job.frames
    return Conditions(
        bboxes=20 * torch.randn(1, frames, job.boxes, 8, 3),
        classes=torch.randint(0, 10, (1, frames, job.boxes)),
        masks=torch.randint(0, 2, (views, frames, job.boxes)),
        box_latent=torch.randn(job.boxes, config.hidden),
        cams=torch.randn(views, frames, 1, 3, 7),
        rel_pos=torch.eye(4).repeat(frames, 1, 1),
        maps=torch.rand(frames, config.map_layers, job.map_cells, job.map_cells) > 0.8,
        text=TextStates(torch.randn(TEXT_TOKENS, config.caption_channels), torch.arange(TEXT_TOKENS) < job.words),
        fps=12.0,
        height=job.height,
        width=job.width,
    ).to(job.device)


def clock(job: Job) -> float:
    if job.on_gpu:
        torch.cuda.synchronize()
        return time.perf_counter()
    return time.process_time()


def measured_decoder(job: Job) -> Line:
    """Seconds of decoding one view, in this process."""
    made = DIFFUSERS.imported().AutoencoderKLCogVideoX
    small = job.tiny or not job.on_gpu
    network = made(block_out_channels=SMALL_DECODER) if small else made()
    decoder = VideoDecoder(network.to(torch.bfloat16 if job.on_gpu else torch.float32), torch.device(job.device))
    size = LatentSize.of(job.frames, job.height, job.width)
    latent = torch.randn(16, size.frames, size.rows, size.columns)
    decoder.frames(latent[:, :2])
    if job.on_gpu:
        torch.cuda.reset_peak_memory_stats()
    started = clock(job)
    for _ in range(job.evaluations):
        decoder.frames(latent)
    seconds = (clock(job) - started) / job.evaluations
    peak = torch.cuda.max_memory_allocated() if job.on_gpu else 1024 * _resident()
    return Line(seconds, 0.0, peak / 2**30)


def measured(job: Job) -> Line:
    """One line, in this process."""
    torch.manual_seed(0)
    if job.mode == "decoder":
        return measured_decoder(job)
    with torch.device(job.device):
        network = MagicDriveDiT(job.config).eval().requires_grad_(False)
    network = network.to(torch.bfloat16) if job.on_gpu else network
    conditions = random_conditions(job)
    if "compiled" in job.mode:
        network.compile_blocks("eager" if job.tiny else "inductor")
    together, kept = "together" in job.mode, "kept" in job.mode

    def encoded() -> GuidedModel:
        return GuidedModel.of(network, conditions, together=together, keep_keys_values=kept)

    size = network.size_of(conditions)
    latent = torch.randn(1, 96, size.frames, size.rows, size.columns, device=job.device)
    timestep = torch.tensor([500.0], device=job.device)
    with torch.no_grad():
        guided = encoded()
        started = clock(job)
        guided = encoded()
        encoding = clock(job) - started
        for _ in range(2 if job.on_gpu else 1):
            guided.velocity(latent, timestep)
        if job.on_gpu:
            torch.cuda.reset_peak_memory_stats()
        started = clock(job)
        for _ in range(job.evaluations):
            guided.velocity(latent, timestep)
        seconds = (clock(job) - started) / job.evaluations
        peak = torch.cuda.max_memory_allocated() if job.on_gpu else 1024 * _resident()
        parts = {} if "compiled" in job.mode else by_part(job, network, lambda: guided.velocity(latent, timestep))
    return Line(seconds, encoding, peak / 2**30, parts)


def by_part(job: Job, network: MagicDriveDiT, evaluate: Callable[[], Tensor]) -> dict[str, float]:
    """Seconds in each kind of layer, in an evaluation that waits for each of them."""
    spent: dict[str, float] = defaultdict(float)
    started: list[float] = []
    handles = []
    for block, _ in network.blocks:
        for part in PARTS:
            layer = getattr(block, part)
            if layer is None:
                continue
            name = f"{part}, {'frames' if block.temporal else 'places'}" if part == "attn" else part

            def begin(_module: nn.Module, _inputs: Any) -> None:
                started.append(clock(job))

            def end(_module: nn.Module, _inputs: Any, _out: Any, name: str = name) -> None:
                spent[name] += clock(job) - started.pop()

            handles += [layer.register_forward_pre_hook(begin), layer.register_forward_hook(end)]
    whole = clock(job)
    evaluate()
    whole = clock(job) - whole
    for handle in handles:
        handle.remove()
    spent["rest"] = whole - sum(spent.values())
    return {name: seconds / whole for name, seconds in spent.items()}


def _resident() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def measured_or_why(job: Job) -> Line:
    try:
        return measured(job)
    except Exception as error:
        return Line(failure=f"{type(error).__name__}: {(str(error).splitlines() or [''])[0][:150]}")


def describe(job: Job, line: Line) -> str:
    if line.failure is not None:
        return f"{job.mode:14s} not measured: {line.failure}"
    if job.mode == "decoder":
        scene = job.config.views * line.seconds
        return f"{job.mode:14s} {line.seconds:8.3f} s a view, scene {scene:.1f} s, {line.peak_gib:.1f} GiB peak"
    scene = STEPS * line.seconds + line.encoding
    rate = 2 * job.count(as_published=False).transformer / line.seconds / 1e12
    parts = ", ".join(f"{name} {share:.0%}" for name, share in sorted(line.parts.items(), key=lambda part: -part[1]))
    return (
        f"{job.mode:14s} {line.seconds / 2:8.3f} s an evaluation, encoders {line.encoding:.2f} s, scene {scene:.1f} s, "
        f"{rate:.3g} TFLOP/s, {line.peak_gib:.1f} GiB peak{'; ' if parts else ''}{parts}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    on_gpu = torch.cuda.is_available()
    parser.add_argument("--device", default="cuda" if on_gpu else "cpu")
    parser.add_argument("--mode", action="append", choices=MODES)
    parser.add_argument("--size", default="224x400" if on_gpu else "96x160", help="height x width, pixels")
    parser.add_argument("--frames", type=int, default=241 if on_gpu else 9)
    parser.add_argument("--boxes", type=int, default=60)
    parser.add_argument("--words", type=int, default=31)
    parser.add_argument("--evaluations", type=int, default=3 if on_gpu else 1)
    chosen = parser.parse_args()
    height, width = (int(side) for side in chosen.size.split("x"))
    sizes = (chosen.frames, height, width, chosen.boxes, chosen.words, chosen.evaluations)
    jobs = [
        Job(chosen.device, mode, *sizes) for mode in chosen.mode or (MODES if on_gpu else ("plain", "kept", "decoder"))
    ]
    hardware = torch.cuda.get_device_name() if jobs[0].on_gpu else f"processor, {torch.get_num_threads()} thread(s)"
    print(f"{hardware}, torch {torch.__version__}, {chosen.frames} frames of {chosen.size}, random weights")
    published, own = (jobs[0].count(as_published=flag) for flag in (True, False))
    print(
        f"operations of a scene: {published.scene(STEPS, as_published=True):.4g} as published, "
        f"{own.scene(STEPS):.4g} here; the paper's scene takes {PUBLISHED_SECONDS:.0f} s on four L20"
    )
    for job in jobs:
        with multiprocessing.get_context("spawn").Pool(1) as process:
            print(describe(job, process.apply(measured_or_why, (job,))), flush=True)


if __name__ == "__main__":
    main()
