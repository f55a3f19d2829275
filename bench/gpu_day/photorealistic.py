"""Pieces about MagicDriveDiT: what a scene of the paper's size and length costs, with random weights."""

from functools import partial
from typing import Any, Final

from bench.gpu_day.magicdrive_speed import PUBLISHED_SECONDS, STEPS, Job, measured
from bench.gpu_day.pieces import Piece, Setting, with_random_weights

SIZES: Final = {"224x400": (224, 400), "424x800": (424, 800)}
"""The paper's size, and the larger one that the network draws."""
FRAMES: Final = 241
BOXES, WORDS = 60, 31
VIEWS: Final = 6


def cost(setting: Setting, *, mode: str, size: str) -> dict[str, Any]:
    """Seconds and memory of a scene of 241 frames and six cameras: its share of the network, or of the decoder."""
    height, width = (32, 64) if setting.tiny else SIZES[size]
    frames = 9 if setting.tiny else FRAMES
    job = Job(setting.device, mode, frames, height, width, BOXES, WORDS, 1 if setting.tiny else 3, setting.tiny)
    line = measured(job)
    scene_s = VIEWS * line.seconds if mode == "decoder" else STEPS * line.seconds + line.encoding
    return with_random_weights(
        line.peak_gib,
        frames,
        scene_s=scene_s,
        step_s=line.seconds,
        encoders_s=line.encoding,
        size=f"{height}x{width}",
    )


def cost_said(figures: dict[str, Any]) -> str:
    """For people."""
    return (
        f"{figures['scene_s']:.1f} s a scene of {figures['frames']} frames at {figures['size']}, "
        f"{figures['peak_gib']:.1f} GiB peak, {figures['weights']} weights (published: {PUBLISHED_SECONDS:.0f} s on "
        "four L20, decoder included)"
    )


def photorealistic_pieces() -> tuple[Piece, ...]:
    """All of them."""
    wanted = [(mode, "224x400") for mode in ("plain", "kept", "compiled-kept", "decoder")] + [("kept", "424x800")]
    return tuple(
        Piece(
            f"magicdrive-{mode}-{size}", f"a scene of {FRAMES} frames", partial(cost, mode=mode, size=size), cost_said
        )
        for mode, size in wanted
    )
