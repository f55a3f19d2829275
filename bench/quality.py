"""How fast video quality is scored: networks of the published sizes with random weights, pictures of the usual sizes.

Prints pictures a second (processor time on a CPU, wall time on a GPU) and, from them, how long a scene of nuScenes
takes.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmark.extensions.quality.consistency import SubjectFeatures
from benchmark.extensions.quality.cut_masks import Mask
from benchmark.extensions.quality.imaging import ImagingQuality
from benchmark.extensions.quality.musiq import Musiq
from benchmark.extensions.quality.segmentation import Segmenter
from benchmark.machine.devices import device_of, single_precision
from benchmark.machine.workers import single_threaded

FRAME = (450, 800)
SUBJECT = (90, 140)
FRAMES_OF_A_SCENE, SUBJECTS_OF_A_SCENE = 240, 1200
"""Keyframes of six cameras over 20 s, and appearances of at least 1,024 pixels in them, about."""


def sam2_large() -> Any:
    from transformers import Sam2VideoConfig

    backbone = {
        "model_type": "sam2_hiera_det_model",
        "hidden_size": 144,
        "num_attention_heads": 2,
        "blocks_per_stage": [2, 6, 36, 4],
        "embed_dim_per_stage": [144, 288, 576, 1152],
        "num_attention_heads_per_stage": [2, 4, 8, 16],
        "window_size_per_stage": [8, 4, 16, 8],
        "global_attention_blocks": [23, 33, 43],
        "window_positional_embedding_background_size": [7, 7],
    }
    vision = {
        "model_type": "sam2_vision_model",
        "backbone_config": backbone,
        "backbone_channel_list": [1152, 576, 288, 144],
    }
    return Sam2VideoConfig(vision_config=vision)


def seconds(work: Callable[[], object], device: torch.device, times: int) -> float:
    """Of one call, after a first one that is not counted."""
    clock = time.perf_counter if device.type == "cuda" else time.process_time
    work()
    started = clock()
    for _ in range(times):
        work()
    return (clock() - started) / times


def metrics(folder: Path, device: torch.device, batch: int, times: int) -> None:
    from transformers import ViTConfig, ViTModel

    ViTModel(ViTConfig(), add_pooling_layer=False).save_pretrained(folder / "dino")
    torch.save(Musiq().state_dict(), folder / "musiq.pth")
    rng = np.random.default_rng(0)
    frame = rng.integers(0, 256, (*FRAME, 3), dtype=np.uint8)
    mask = Mask(0, 0, np.ones(SUBJECT, bool))
    dino = SubjectFeatures(folder / "dino", device, 224, batch)
    musiq = ImagingQuality(folder / "musiq.pth", device, 512, batch)
    parts = (
        ("DINO, subjects", SUBJECTS_OF_A_SCENE, lambda: dino.features([(frame, mask)] * batch)),
        ("MUSIQ, subjects", SUBJECTS_OF_A_SCENE, lambda: musiq.scores([mask.cut(frame)] * batch)),
        ("MUSIQ, frames", FRAMES_OF_A_SCENE, lambda: musiq.scores([frame] * batch)),
    )
    total_s = 0.0
    for name, count, work in parts:
        each_s = seconds(work, device, times) / batch
        total_s += each_s * count
        print(f"{name:<18}{1 / each_s:8.1f} a second {each_s * count:8.0f} s a scene ({count})")
    print(f"{'both metrics':<18}{'':17} {total_s:8.0f} s a scene")


def tracking(folder: Path, device: torch.device) -> None:
    from transformers import Sam2VideoModel

    Sam2VideoModel(sam2_large()).save_pretrained(folder / "sam2")
    frame = np.random.default_rng(0).integers(0, 256, (*FRAME, 3), dtype=np.uint8)
    segmenter = Segmenter(folder / "sam2", device)
    clock = time.perf_counter if device.type == "cuda" else time.process_time
    video = segmenter.open([frame] * 3)
    for name, work in (
        ("first subject, frame 1", lambda: video.begin(0, (10.0, 10.0, 200.0, 200.0))),
        ("first subject, frame 2", lambda: video.follow(1)),
        ("another one, frame 1", lambda: video.begin(0, (300.0, 10.0, 500.0, 200.0))),
        ("another one, frame 2", lambda: video.follow(1)),
    ):
        started = clock()
        work()
        print(f"SAM 2 large, {name}: {clock() - started:.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--times", type=int, default=2)
    parser.add_argument("--sam2", action="store_true", help="also SAM 2 (2 GB of memory)")
    arguments = parser.parse_args()
    single_threaded()
    device = device_of(arguments.device)
    print(f"on {device}, batches of {arguments.batch}")
    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as folder, single_precision():
        metrics(Path(folder), device, arguments.batch, arguments.times)
        if arguments.sam2:
            tracking(Path(folder), device)


if __name__ == "__main__":
    main()
