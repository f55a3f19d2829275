"""Seeded, logged and resumable training of a network by its objective, in phases that follow one another."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import torch
from torch import Tensor, nn

from adapters.extensions.training.frames import BatchObjective, CachingObjective, Frames, Objective, TrainingFrame
from benchmark.errors import InputError
from benchmark.machine.devices import select_device
from benchmark.machine.progress import CountedUnits, track_progress
from benchmark.machine.storage import content_key, content_seed, write_json_lines
from benchmark.machine.workers import single_threaded
from benchmark.weights.tensors import TrainingRun, hash_tensors, read_run, write_run

LOG_EVERY: Final = 50
"""Steps whose mean losses are one row of the log; a run is only ever interrupted between two such rows."""
KEEP_EVERY_S: Final = 120.0
"""Time between two copies of an unfinished run on disk."""
_ENTRY: Final = "run"
"""Of the header of an unfinished run: what it says of itself."""
IMAGE_ENCODER: Final = "img_backbone."
"""How the names of the image encoder's parameters begin, in all four networks."""
Check = Callable[[dict[str, Tensor]], dict[str, float]]


@dataclass(frozen=True, slots=True)
class Recipe:
    """Recipe of a training: how long and how fast a network learns.

    `learning_rate` is the peak after `warmup` steps of linear rise; it falls to a hundredth along a cosine.
    `encoder_rate` is the share of it for the image encoder; `weight_decay` is per step, times the learning rate.
    Gradients of `clips` make one step; `scattered` clips are of any frames, for networks that look at each alone;
    gradients longer than `gradient_norm` are shortened. `average` is the share of the averaged weights kept per step,
    less in the beginning; `check_every` steps are between two checks on held-out scenes.
    """

    steps: int
    learning_rate: float = 6e-4
    encoder_rate: float = 0.5
    warmup: int = 200
    weight_decay: float = 1e-2
    clips: int = 1
    scattered: bool = False
    gradient_norm: float = 5.0
    average: float = 0.998
    check_every: int = 2000
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.steps, self.clips, self.check_every) < 1:
            raise InputError("training needs at least one step, one clip a step and one step between checks")


def fit(
    objective: Objective,
    store: Frames,
    frames: Sequence[int],
    recipe: Recipe,
    out: Path,
    *,
    check: Check | None = None,
    device: str = "auto",
    keep_every_s: float = KEEP_EVERY_S,
) -> dict[str, Tensor]:
    """Train; the same command resumes. Each of `frames` is the last of a clip.

    Frames and random draws of a step depend only on the seed and its number, so an interrupted run ends with the same
    weights as an undisturbed one. ``.progress.safetensors`` (until finished, copied each `keep_every_s`) and
    ``.log.jsonl`` lie beside `out`; `check` measures averaged weights for the log, not at the end.
    """
    if not frames:
        raise InputError("there are no frames to train on; give a split with more scenes")
    single_threaded()
    place = select_device(device)
    network = objective.network.to(place)
    use_channels_last(network)
    unfinished, log_path = out.with_suffix(".progress.safetensors"), out.with_suffix(".log.jsonl")
    identity = content_key(asdict(recipe), store.identity, list(frames), hash_tensors(network.state_dict()))
    run = TrainingRun(network, _optimiser(network, recipe), _copy_tensors(network.state_dict()), [])
    if unfinished.exists():
        read_run(run, unfinished, identity, "settings, frames or initial weights", entry=_ENTRY)
    # Before the first step, so that an unwritable path is reported at once.
    write_json_lines(log_path, run.log)
    if run.step < recipe.steps and isinstance(objective, CachingObjective):
        store, frames = objective.look(store, frames)
    network.train()
    kept_s = time.monotonic()
    sums: dict[str, float] = {}
    for step in track_progress(
        range(run.step, recipe.steps),
        total=recipe.steps - run.step,
        label=f"training {out.stem}",
        count=CountedUnits("step", run.step),
    ):
        for name, value in _take_step(run, objective, store, frames, recipe).items():
            sums[name] = sums.get(name, 0.0) + value
        run.step = step + 1
        last = run.step == recipe.steps
        if run.step % LOG_EVERY == 0 or last:
            counted = (run.step - 1) % LOG_EVERY + 1
            run.log.append({"step": run.step, **{name: round(value / counted, 5) for name, value in sums.items()}})
            sums = {}
            if check is not None and run.step % recipe.check_every < LOG_EVERY and not last:
                run.log[-1] |= check(run.average)
            write_json_lines(log_path, run.log)
            if time.monotonic() - kept_s > keep_every_s or last:
                write_run(run, unfinished, identity, entry=_ENTRY)
                kept_s = time.monotonic()
    return {name: tensor.cpu() for name, tensor in run.average.items()}


def use_channels_last(network: nn.Module) -> None:
    """Lay out the weights of the image encoder so that its convolutions are a quarter faster on a processor."""
    for name, module in network.named_children():
        if f"{name}." == IMAGE_ENCODER:
            module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def select_clip(store: Frames, frames: Sequence[int], recipe: Recipe, length: int, draw: int) -> list[TrainingFrame]:
    """The clip of a draw: every frame ends one clip before any ends a second one."""
    if not recipe.scattered:
        return store.clip(_draw_frame(frames, recipe.seed, draw), length)
    return [store.frame(_draw_frame(frames, recipe.seed, draw * length + offset)) for offset in range(length)]


def _draw_frame(frames: Sequence[int], seed: int, draw: int) -> int:
    round_number, place = divmod(draw, len(frames))
    return frames[int(_shuffled_order(len(frames), seed, round_number)[place])]


_orders: dict[tuple[int, int, int], Any] = {}


def _shuffled_order(count: int, seed: int, round_number: int) -> Any:
    key = (count, seed, round_number)
    if key not in _orders:
        _orders.clear()
        _orders[key] = np.random.default_rng(content_seed("order of frames", *key)).permutation(count)
    return _orders[key]


def _optimiser(network: nn.Module, recipe: Recipe) -> torch.optim.AdamW:
    learned = [(name, parameter) for name, parameter in network.named_parameters() if parameter.requires_grad]
    groups = [
        {"params": [parameter for name, parameter in learned if name.startswith(IMAGE_ENCODER) is encoder], "at": rate}
        for encoder, rate in ((True, recipe.encoder_rate), (False, 1.0))
    ]
    return torch.optim.AdamW(
        [group for group in groups if group["params"]], lr=recipe.learning_rate, weight_decay=recipe.weight_decay
    )


def _copy_tensors(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.detach().clone() for name, tensor in tensors.items()}


def learning_rate(recipe: Recipe, step: int) -> float:
    """Learning rate of a step: linear rise, then a cosine that ends at a hundredth of the peak."""
    rising = min((step + 1) / max(recipe.warmup, 1), 1.0)
    falling = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * step / recipe.steps))
    return recipe.learning_rate * rising * falling


def _take_step(
    run: TrainingRun[nn.Module], objective: Objective, store: Frames, frames: Sequence[int], recipe: Recipe
) -> dict[str, float]:
    torch.manual_seed(content_seed("training step", recipe.seed, run.step))
    for group in run.optimiser.param_groups:
        group["lr"] = learning_rate(recipe, run.step) * group["at"]
    run.optimiser.zero_grad(set_to_none=True)
    logged: dict[str, float] = {}
    first = run.step * recipe.clips
    drawn = [
        select_clip(store, frames, recipe, objective.clip_frames, first + offset) for offset in range(recipe.clips)
    ]
    device = next(iter(run.network.parameters())).device
    clips = [[frame.on(device) for frame in clip] for clip in drawn]
    for losses, share in _losses(objective, clips):
        total = torch.stack([loss.float() for loss in losses.values()]).sum()
        if not bool(torch.isfinite(total)):
            raise InputError(
                f"the losses are no longer finite at step {run.step} (clip of {clips[0][-1].scene}); train with a "
                "lower --learning-rate"
            )
        (total * share).backward()  # type: ignore[no-untyped-call]
        for name, loss in {**losses, "loss": total}.items():
            logged[name] = logged.get(name, 0.0) + float(loss.detach()) * share
    learned = [parameter for group in run.optimiser.param_groups for parameter in group["params"]]
    logged["gradient"] = float(torch.nn.utils.clip_grad_norm_(learned, recipe.gradient_norm))
    run.optimiser.step()
    # An early average would keep the random start.
    keep = min(recipe.average, (run.step + 1) / (run.step + 10))
    with torch.no_grad():
        for name, tensor in run.network.state_dict().items():
            if tensor.is_floating_point():
                run.average[name].lerp_(tensor, 1.0 - keep)
            else:
                run.average[name].copy_(tensor)
    return logged


def _losses(
    objective: Objective, clips: Sequence[Sequence[TrainingFrame]]
) -> Iterator[tuple[dict[str, Tensor], float]]:
    """Losses and their shares of a step: of all clips at once where the objective can do that, else one by one."""
    if isinstance(objective, BatchObjective):
        yield objective.losses_of(clips), 1.0
        return
    for clip in clips:
        yield objective.losses(clip), 1 / len(clips)


@dataclass(frozen=True, slots=True)
class Phase:
    """Part of a training, from the averaged weights before it; `objective` may set first values and what learns."""

    name: str
    objective: Callable[[Any], Objective]
    recipe: Recipe

    def changed(self, share: float, seed: int, learning_rate: float | None) -> Self:
        """The same phase with a share of its steps; a learning rate of ``None`` is the recipe's own."""
        steps = max(round(self.recipe.steps * share), 1)
        peak = self.recipe.learning_rate if learning_rate is None else learning_rate
        return replace(self, recipe=replace(self.recipe, steps=steps, seed=seed, learning_rate=peak))
