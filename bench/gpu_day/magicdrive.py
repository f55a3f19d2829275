"""Pieces about MagicDriveDiT: what a scene of the paper's size and length costs, with random weights.

A scene is 30 steps with two evaluations each and, once, the encoders of both branches; the text encoder (0.01 % of the
operations) is left out.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Final

import torch

from bench.gpu_day.pieces import Piece, Setting, mean_seconds
from generation.extensions.magicdrive.checkpoint import DIFFUSERS, VideoDecoder
from generation.extensions.magicdrive.conditions import TEXT_TOKENS, ClipConditions, TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.layers import LatentSize
from generation.extensions.magicdrive.model import MagicDriveDiT
from generation.extensions.magicdrive.sampling import GuidedModel

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


def config_of(setting: Setting) -> MagicDriveConfig:
    """Sizes of the network: the published ones on a GPU alone."""
    if setting.tiny:
        return TINY
    return MagicDriveConfig.full() if setting.on_gpu else REDUCED


def random_conditions(config: MagicDriveConfig, frames: int, height: int, width: int) -> ClipConditions:
    """Random numbers of the right sizes: time does not depend on them."""
    # The map is finer for larger images.
    views, cells = config.views, 200 if height <= 224 else 400
    return ClipConditions(
        bboxes=20 * torch.randn(1, frames, BOXES, 8, 3),
        classes=torch.randint(0, 10, (1, frames, BOXES)),
        masks=torch.randint(0, 2, (views, frames, BOXES)),
        box_latent=torch.randn(BOXES, config.hidden),
        cams=torch.randn(views, frames, 1, 3, 7),
        rel_pos=torch.eye(4).repeat(frames, 1, 1),
        maps=torch.rand(frames, config.map_layers, cells, cells) > 0.8,
        text=TextStates(torch.randn(TEXT_TOKENS, config.caption_channels), torch.arange(TEXT_TOKENS) < WORDS),
        fps=12.0,
        height=height,
        width=width,
    )


def prepare(setting: Setting, mode: str, frames: int, height: int, width: int) -> Callable[[], Callable[[], object]]:
    """What encodes conditions and gives what evaluates once; of the decoder, what decodes one view.

    The mode is ``decoder``, or has words of ``plain``, ``kept``, ``together``, ``compiled``.
    """
    torch.manual_seed(0)
    device, precision = torch.device(setting.device), torch.bfloat16 if setting.on_gpu else torch.float32
    if mode == "decoder":
        made = DIFFUSERS.imported().AutoencoderKLCogVideoX
        coder = made(block_out_channels=SMALL_DECODER) if setting.tiny or not setting.on_gpu else made()
        decoder, size = VideoDecoder(coder.to(precision), device), LatentSize.of(frames, height, width)
        view = torch.randn(16, size.frames, size.rows, size.columns)
        return lambda: lambda: decoder.frames(view)
    with device:
        network = MagicDriveDiT(config_of(setting)).eval().requires_grad_(False)
    network = network.to(precision)
    conditions = random_conditions(config_of(setting), frames, height, width).to(device)
    if "compiled" in mode:
        network.compile_blocks("eager" if setting.tiny else "inductor")
    size = network.compute_latent_size(conditions)
    latent = torch.randn(1, 96, size.frames, size.rows, size.columns, device=device)
    timestep = torch.tensor([500.0], device=device)

    def encoded() -> Callable[[], object]:
        together, kept = "together" in mode, "kept" in mode
        guided = GuidedModel.of(network, conditions, together=together, keep_keys_values=kept)
        return lambda: guided.velocity(latent, timestep)

    return encoded


def cost(setting: Setting, *, mode: str, size: str) -> dict[str, Any]:
    """Seconds and memory of a scene of 241 frames and six cameras: its share of the network, or of the decoder."""
    height, width = (32, 64) if setting.tiny else SIZES[size]
    frames = 9 if setting.tiny else FRAMES
    encoded = prepare(setting, mode, frames, height, width)
    with torch.no_grad():
        evaluate = encoded()
        encoders_s, _ = mean_seconds(setting, encoded, 1)
        for _ in range(2 if setting.on_gpu else 1):
            evaluate()
        step_s, peak = mean_seconds(setting, evaluate, 1 if setting.tiny else 3)
    scene_s = VIEWS * step_s if mode == "decoder" else STEPS * step_s + encoders_s
    spent = {"scene_s": scene_s, "step_s": step_s, "encoders_s": encoders_s}
    return {**spent, "size": f"{height}x{width}", "frames": frames, **peak}


def describe_cost(figures: dict[str, Any]) -> str:
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
        Piece(f"magicdrive-{mode}-{size}", what, partial(cost, mode=mode, size=size), describe_cost)
        for mode, size in wanted
    )
