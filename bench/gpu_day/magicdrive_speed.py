"""Seconds and memory of MagicDriveDiT's transformer and video decoder, with random weights.

Times are of whole evaluations after warming up, synchronised; on a processor they are processor time. A scene is 30
steps with two evaluations each and, once, the encoders of both branches; the text encoder (0.01 % of the operations) is
left out.
"""

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from generation.extensions.magicdrive.autoencoder import DIFFUSERS, VideoDecoder
from generation.extensions.magicdrive.conditions import TEXT_TOKENS, Conditions, TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.guidance import GuidedModel
from generation.extensions.magicdrive.latents import LatentSize
from generation.extensions.magicdrive.model import MagicDriveDiT

STEPS = 30
PUBLISHED_SECONDS = 395.0
"""The paper's rendering time of a scene, decoder included, on four L20."""
REDUCED = replace(MagicDriveConfig.full(), hidden=576, heads=8, depth=2, control_depth=1)
TINY = replace(REDUCED, hidden=144, heads=2)
"""For a trial of a GPU day: the same classes in a second."""
SMALL_DECODER = (32, 32, 32, 32)
"""Channels on a processor; the published ones are the default of the class."""


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


@dataclass(frozen=True, slots=True)
class Line:
    """Seconds of evaluating both branches and of encoding them, peak GiB."""

    seconds: float
    encoding: float
    peak_gib: float


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


def ready(job: Job) -> Callable[[], Callable[[], object]]:
    """What encodes conditions and gives what evaluates once; of the decoder, what decodes one view."""
    torch.manual_seed(0)
    if job.mode == "decoder":
        made = DIFFUSERS.imported().AutoencoderKLCogVideoX
        coder = made(block_out_channels=SMALL_DECODER) if job.tiny or not job.on_gpu else made()
        decoder = VideoDecoder(coder.to(torch.bfloat16 if job.on_gpu else torch.float32), torch.device(job.device))
        size = LatentSize.of(job.frames, job.height, job.width)
        view = torch.randn(16, size.frames, size.rows, size.columns)
        return lambda: lambda: decoder.frames(view)
    with torch.device(job.device):
        network = MagicDriveDiT(job.config).eval().requires_grad_(False)
    network = network.to(torch.bfloat16) if job.on_gpu else network
    conditions = random_conditions(job)
    if "compiled" in job.mode:
        network.compile_blocks("eager" if job.tiny else "inductor")
    size = network.size_of(conditions)
    latent = torch.randn(1, 96, size.frames, size.rows, size.columns, device=job.device)
    timestep = torch.tensor([500.0], device=job.device)

    def encoded() -> Callable[[], object]:
        together, kept = "together" in job.mode, "kept" in job.mode
        guided = GuidedModel.of(network, conditions, together=together, keep_keys_values=kept)
        return lambda: guided.velocity(latent, timestep)

    return encoded


def measured(job: Job) -> Line:
    """One line, in this process."""
    encoded = ready(job)
    with torch.no_grad():
        evaluate = encoded()
        started = clock(job)
        evaluate = encoded()
        encoding = clock(job) - started
        for _ in range(2 if job.on_gpu else 1):
            evaluate()
        if job.on_gpu:
            torch.cuda.reset_peak_memory_stats()
        started = clock(job)
        for _ in range(job.evaluations):
            evaluate()
        seconds = (clock(job) - started) / job.evaluations
    resident = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Line(seconds, encoding, (torch.cuda.max_memory_allocated() if job.on_gpu else resident) / 2**30)
