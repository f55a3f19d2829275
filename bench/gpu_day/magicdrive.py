"""Pieces about MagicDriveDiT: what a scene of the paper's size and length costs, with random weights.

A scene is 30 steps with two evaluations each and, once, the encoders of both branches; the text encoder (0.01 % of the
operations) is left out.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import torch

from bench.gpu_day.pieces import Piece, Setting, mean_seconds, with_random_weights
from generation.extensions.magicdrive.autoencoder import DIFFUSERS, VideoDecoder
from generation.extensions.magicdrive.conditions import TEXT_TOKENS, Conditions, TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.guidance import GuidedModel
from generation.extensions.magicdrive.latents import LatentSize
from generation.extensions.magicdrive.model import MagicDriveDiT

STEPS: Final = 30
PUBLISHED_SECONDS: Final = 395.0
"""The paper's rendering time of a scene, decoder included, on four L20."""
SIZES: Final = {"224x400": (224, 400), "424x800": (424, 800)}
"""The paper's size, and the larger one that the network draws."""
FRAMES, VIEWS, BOXES, WORDS = 241, 6, 60, 31
REDUCED: Final = replace(MagicDriveConfig.full(), hidden=576, heads=8, depth=2, control_depth=1)
TINY: Final = replace(REDUCED, hidden=144, heads=2)
"""For a trial of a GPU day: the same classes in a second."""
SMALL_DECODER: Final = (32, 32, 32, 32)
"""Channels on a processor; the published ones are the default of the class."""


@dataclass(frozen=True, slots=True)
class Job:
    """What is evaluated: where, how (``plain``, ``kept``, ``together``, ``compiled``, ``decoder``), and how large."""

    device: str
    mode: str
    frames: int
    height: int
    width: int
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


def random_conditions(job: Job) -> Conditions:
    """Random numbers of the right sizes: time does not depend on them."""
    config, views, frames = job.config, job.config.views, job.frames
    # The map is finer for larger images.
    cells = 200 if job.height <= 224 else 400
    return Conditions(
        bboxes=20 * torch.randn(1, frames, BOXES, 8, 3),
        classes=torch.randint(0, 10, (1, frames, BOXES)),
        masks=torch.randint(0, 2, (views, frames, BOXES)),
        box_latent=torch.randn(BOXES, config.hidden),
        cams=torch.randn(views, frames, 1, 3, 7),
        rel_pos=torch.eye(4).repeat(frames, 1, 1),
        maps=torch.rand(frames, config.map_layers, cells, cells) > 0.8,
        text=TextStates(torch.randn(TEXT_TOKENS, config.caption_channels), torch.arange(TEXT_TOKENS) < WORDS),
        fps=12.0,
        height=job.height,
        width=job.width,
    ).to(job.device)


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


def cost(setting: Setting, *, mode: str, size: str) -> dict[str, Any]:
    """Seconds and memory of a scene of 241 frames and six cameras: its share of the network, or of the decoder."""
    height, width = (32, 64) if setting.tiny else SIZES[size]
    frames = 9 if setting.tiny else FRAMES
    encoded = ready(Job(setting.device, mode, frames, height, width, setting.tiny))
    with torch.no_grad():
        evaluate = encoded()
        encoders_s, _ = mean_seconds(setting, encoded, 1)
        for _ in range(2 if setting.on_gpu else 1):
            evaluate()
        step_s, peak_gib = mean_seconds(setting, evaluate, 1 if setting.tiny else 3)
    figures = {"step_s": step_s, "encoders_s": encoders_s, "size": f"{height}x{width}"}
    scene_s = VIEWS * step_s if mode == "decoder" else STEPS * step_s + encoders_s
    return with_random_weights(peak_gib, frames, scene_s=scene_s, **figures)


def cost_said(figures: dict[str, Any]) -> str:
    """For people."""
    return (
        f"{figures['scene_s']:.1f} s a scene of {figures['frames']} frames at {figures['size']}, "
        f"{figures['peak_gib']:.1f} GiB peak, {figures['weights']} weights (published: {PUBLISHED_SECONDS:.0f} s on "
        "four L20, decoder included)"
    )


def magicdrive_pieces() -> tuple[Piece, ...]:
    """All of them."""
    wanted = [(mode, "224x400") for mode in ("plain", "kept", "compiled-kept", "decoder")] + [("kept", "424x800")]
    what = f"a scene of {FRAMES} frames"
    return tuple(
        Piece(f"magicdrive-{mode}-{size}", what, partial(cost, mode=mode, size=size), cost_said)
        for mode, size in wanted
    )
