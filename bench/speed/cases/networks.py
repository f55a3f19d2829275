"""Networks: the trajectory denoiser, the planners, MagicDriveDiT, and what scores video quality.

Weights are random where speed does not depend on them. Planners and MagicDriveDiT run on a processor here; on a GPU
`bench/gpu.py` measures them.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.speed.case import Case

BATCH = 256
PREVIOUS = np.array([-4.0, 0.0, 0.0])
SIZES = {
    "feature_dim": 64,
    "heads": 4,
    "layers": 3,
    "feedforward_dim": 192,
    "history_tokens": 0,
    "preconditioned": True,
}
"""Of the small transformer that the packaged denoiser is an alternative to."""
PLANNERS = ("uniad", "vad-base", "vad-tiny", "sparsedrive", "diffusiondrive")
FRAME, SUBJECT = (450, 800), (90, 140)
A_SCENE = {"dino": 1200, "musiq-subjects": 1200, "musiq-frames": 240}
"""Keyframes of six cameras over 20 s, and appearances of at least 1,024 pixels in them, about."""


def call_once(work: Callable[[], object]) -> tuple[float, Any]:
    """A side of a state that is a function."""
    return 1, work()


def sides(name: str, measures: str, setup: Callable[[bool], Any], unit: str, beside: str) -> Case:
    """A case whose state is a pair of functions, ours and the other."""
    ours, other = (lambda state: call_once(state[0])), (lambda state: call_once(state[1]))
    return Case(name, measures, lambda quick, _: setup(quick), ours, unit, (beside, other))


def denoise_calls(other: dict[str, Any], _quick: bool) -> Any:
    import torch

    from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, load_denoiser
    from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser

    noisy = torch.from_numpy(np.random.default_rng(0).standard_normal((BATCH, 16, 3)).astype(np.float32))

    def call(denoiser: Any) -> object:
        with torch.inference_mode():
            return denoiser(noisy, torch.tensor([4.0]))

    large = TrajectoryDenoiser(DenoiserConfig(**other)).eval()
    ours = partial(call, load_denoiser(PACKAGED_WEIGHTS))
    ours()
    return ours, partial(call, large)


def first_batches(source: str, _quick: bool) -> Any:
    from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, load_denoiser, sample_actions
    from generation.diffusion.prior import CandidateSource, SamplerSettings, TrajectoryPrior

    prior = TrajectoryPrior.load(None, SamplerSettings(samples=CandidateSource(source)))
    denoiser = load_denoiser(PACKAGED_WEIGHTS)
    return (
        lambda: prior.sample(BATCH, PREVIOUS, np.random.default_rng(0)),
        lambda: sample_actions(denoiser, BATCH, 100, np.random.default_rng(0)),
    )


def planning_steps(calls: int | None, _quick: bool) -> Any:
    """Initial batch and the five rounds of refinement, without physics and scoring."""
    from generation.diffusion.prior import SamplerSettings, TrajectoryPrior, diversify

    def step(prior: Any) -> object:
        rng = np.random.default_rng(0)
        candidates = diversify(prior.sample(BATCH, PREVIOUS, rng), rng)
        for level in (5, 4, 3, 2, 1):
            candidates = prior.mutate(candidates, level, PREVIOUS, rng)
        return candidates

    slow = TrajectoryPrior.load(None, SamplerSettings(mutation_steps=None))
    fast = TrajectoryPrior.load(None, SamplerSettings(mutation_steps=calls)) if calls else TrajectoryPrior.load()
    return partial(step, fast), partial(step, slow)


def planner_network(name: str, quick: bool, folder: Path) -> Any:
    from bench.gpu_day.networks import ready
    from bench.gpu_day.pieces import Setting

    return ready(Setting(folder, "cpu", tiny=quick), name, "float32")[1]


def magicdrive(mode: str, quick: bool) -> Any:
    import torch

    from bench.gpu_day.magicdrive import prepare
    from bench.gpu_day.pieces import Setting

    setting, size = Setting(Path(), "cpu", tiny=quick), (32, 64) if quick else (96, 160)
    with torch.no_grad():
        return [torch.no_grad()(prepare(setting, variant, 9, *size)()) for variant in (mode, "plain")]


def quality(part: str, device_name: str, quick: bool, folder: Path) -> Any:
    """What scores a batch of pictures, and its size."""
    import torch
    from transformers import ViTConfig, ViTModel

    from benchmark.extensions.quality.masks import CroppedMask
    from benchmark.extensions.quality.musiq import Musiq
    from benchmark.extensions.quality.scoring import ImagingQuality, SubjectFeatureExtractor
    from benchmark.machine.devices import select_device

    torch.manual_seed(0)
    device, batch = select_device(device_name), 1 if quick else 16
    frame = np.random.default_rng(0).integers(0, 256, (*FRAME, 3), dtype=np.uint8)
    mask = CroppedMask(0, 0, np.ones(SUBJECT, bool))
    if part == "dino":
        ViTModel(ViTConfig(), add_pooling_layer=False).save_pretrained(folder / "dino")
        dino = SubjectFeatureExtractor(folder / "dino", device, 224, batch)
        return batch, partial(dino.features, [(frame, mask)] * batch)
    torch.save(Musiq().state_dict(), folder / "musiq.pth")
    musiq = ImagingQuality(folder / "musiq.pth", device, 512, batch)
    return batch, partial(musiq.scores, [mask.cut(frame) if part == "musiq-subjects" else frame] * batch)


def score_pictures(state: Any) -> tuple[float, Any]:
    from benchmark.machine.devices import single_precision

    with single_precision():
        return state[0], state[1]()


CASES = (
    *(
        sides(
            f"denoiser/call{suffix}",
            f"A call of the packaged denoiser, 256 trajectories, beside: {what}.",
            partial(denoise_calls, sizes),
            "call",
            what,
        )
        for suffix, sizes, what in (
            ("", {}, "reference's size"),
            ("-small-transformer", SIZES, "small transformer"),
        )
    ),
    *(
        sides(
            f"denoiser/first-batch-{source}",
            f"256 first trajectories, {source}, beside the full process of 100 calls.",
            partial(first_batches, source),
            "batch",
            "full process",
        )
        for source in ("fresh", "reference", "stored")
    ),
    *(
        sides(
            f"denoiser/planning-step{suffix}",
            "A planning step, first batch and five rounds, beside the reference's number of calls a round.",
            partial(planning_steps, calls),
            "step",
            "reference's calls",
        )
        for suffix, calls in (("", None), ("-1-call", 1), ("-2-calls", 2))
    ),
    *(
        Case(
            f"models/{name}",
            f"A frame of {name} on a processor, batch 1, warm, single precision.",
            partial(planner_network, name),
            call_once,
            "frame",
        )
        for name in PLANNERS
    ),
    *(
        sides(
            f"magicdrive/{mode}",
            f"An evaluation of both branches of MagicDriveDiT of reduced size, {what}, beside a plain one.",
            partial(magicdrive, mode),
            "evaluation",
            "plain",
        )
        for mode, what in (("kept", "keys and values kept"), ("together", "both branches in a batch"))
    ),
    Case(
        "magicdrive/decoder",
        "The video decoder with few channels on one view.",
        lambda quick, _: magicdrive("decoder", quick)[0],
        call_once,
        "view",
        needs=("diffusers",),
    ),
    *(
        Case(
            f"quality{'-gpu' * (device == 'cuda')}/{part}",
            f"Video quality: {part}, networks of the published sizes, batches of 16; {count} pictures are a scene.",
            partial(quality, part, device),
            score_pictures,
            "picture",
            needs=("transformers", *["gpu"] * (device == "cuda")),
            wall=device == "cuda",
        )
        for device in ("cpu", "cuda")
        for part, count in A_SCENE.items()
    ),
)
