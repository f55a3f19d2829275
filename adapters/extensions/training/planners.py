"""Training of a miniature from a data set to a weights file: what ``challenger-bench train planner`` runs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor, nn

from adapters.camera_inputs import RGB_MEAN_STD
from adapters.checkpoints.cache import Provenance, load_weights, write_weights
from adapters.checkpoints.checkpoint_import import resolve_checkpoint
from adapters.extensions.training.card import format_card
from adapters.extensions.training.dataset_mixture import (
    ADVERSARIAL_SPLIT,
    MixedFrames,
    PrefixedScenes,
    RecordedFutureFrames,
    cached_frames_of,
    require_distinct_data,
    require_source_scenes,
)
from adapters.extensions.training.frames import Frames, TrainingFrame
from adapters.extensions.training.image_encoder import ImageEncoder, ImageEncoderObjective
from adapters.extensions.training.plan_figures import (
    EvaluatedPlans,
    ImageAblation,
    ImageCondition,
    evaluate_plans,
    plan_figures,
)
from adapters.extensions.training.trainer import IMAGE_ENCODER, Phase, Recipe, fit
from adapters.models import Model, miniature, resolve
from adapters.planners.constant_velocity import ConstantVelocity
from benchmark.constants import VERSION
from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.machine.environment import read_source_state
from benchmark.machine.storage import (
    content_seed,
    file_sha256,
    read_json,
    write_bytes,
    write_json,
)
from benchmark.weights.tensors import hash_tensors, read_tensors

ENCODER_NAME: Final = "image-encoder"
"""Name for ``--model`` of the network that all miniatures start from."""
ENCODER_PYRAMID: Final = "pyramid."
PYRAMID: Final = "img_neck."
"""The image encoder's feature pyramid is the one that the sparse networks have under this name (``--start-from``)."""
HELD_OUT_EVERY: Final = 75
"""Of the scenes of a split, one in so many is not trained on and measures."""
ANCHORS_EVERY, ANCHOR_FRAMES = 10, 400
"""Of the frames, one in so many gives first values (anchors, places of queries); more of them in small splits."""
VALIDATION_SPLIT: Final = "val"
"""Split of the data set that the result is measured on."""
HALF_FROM: Final = 256
"""Tensors of at least so many numbers are stored in half precision."""
_ENCODER_RECIPE: Final = Recipe(
    steps=900, learning_rate=2e-3, encoder_rate=1.0, warmup=60, average=0.98, scattered=True, gradient_norm=10.0
)


@dataclass(frozen=True, slots=True)
class PlannerTraining:
    """Settings of the training of a planner.

    Attributes:
        model: A miniature, or `ENCODER_NAME`.
        out: Weights file to write; log, progress, facts and card lie beside it.
        steps: Steps of all phases together, or ``None`` for the recipes' own.
        learning_rate: Peak, or ``None`` for the recipes' own.
        start_from: Weights to start from wherever name and shape agree; of what several files have, the last counts.
        judged_on: Data set on whose split ``val`` the result is measured; on held-out scenes of the split if none.
        workers: Processes that gather the frames.
        adversarial: Roots of adversarial scenes made from scenes of the split, learned from as well.
        also: Roots of other data sets whose scenes of the split are learned from as well; none of these is held out.
        only: Names of the phases that are run; all by default.
        kept_of_start: Share of the weights that it started from in what is written, a weighted mean of both (Wortsman
            et al., 2022): what was learned last takes less of what was known before.
    """

    model: str
    data_root: Path
    split: str
    out: Path
    steps: int | None = None
    seed: int = 0
    learning_rate: float | None = None
    image_encoder: Path | None = None
    start_from: tuple[Path, ...] = ()
    judged_on: Path | None = None
    device: str = "auto"
    workers: int = 1
    adversarial: tuple[Path, ...] = ()
    also: tuple[Path, ...] = ()
    only: tuple[str, ...] = ()
    kept_of_start: float = 0.0

    def __post_init__(self) -> None:
        if self.model != ENCODER_NAME:
            miniature(self.model)
        if self.out.suffix != ".safetensors":
            raise InputError(f"weights are written as .safetensors, not {self.out.name}; choose another --out")
        if self.steps is not None and self.steps < 1:
            raise InputError(f"--steps must be at least 1, got {self.steps}")
        if self.learning_rate is not None and not 0 < self.learning_rate < 1:
            raise InputError(f"--learning-rate must be between 0 and 1, got {self.learning_rate}")
        if not 0 <= self.kept_of_start < 1:
            raise InputError(f"--kept-of-start is a share below 1, got {self.kept_of_start:g}")
        if self.kept_of_start and (not self.start_from or self.model == ENCODER_NAME):
            raise InputError("--kept-of-start keeps of the weights of a miniature that are given with --start-from")


def train_planner(training: PlannerTraining) -> dict[str, Any]:
    """Train and write weights, facts (JSON) and model card; the same command resumes.

    Raises:
        InputError: If the data, the split or the weights to start from cannot be used, nothing is there to train on,
            the progress file belongs to another run, the losses are no longer finite, or a file cannot be written.
    """
    # Unusable inputs are refused at once, not after minutes of gathering frames.
    _select_phases(training)
    given_weights = _read_start_weights(training)
    data = open_data(training.data_root)
    judge = None if training.judged_on is None else open_data(training.judged_on)
    sources = {root: require_source_scenes(root, data, training.split) for root in training.adversarial}
    require_distinct_data(training.also, data)
    recorded = cached_frames_of(training.data_root, training.split, workers=training.workers)
    held_out = recorded.scenes[::HELD_OUT_EVERY] if len(recorded.scenes) > 1 else ()
    more: list[Frames] = []
    for root, made_from_of in sources.items():
        adversarial = cached_frames_of(root, ADVERSARIAL_SPLIT, workers=training.workers)
        more.append(RecordedFutureFrames(adversarial, recorded, made_from_of))
    for place, root in enumerate(training.also, start=1):
        # By its place, not by the folder's name: the same data give the same weights wherever they lie.
        more.append(PrefixedScenes(cached_frames_of(root, training.split, workers=training.workers), f"also-{place}"))
    store: Frames = MixedFrames([recorded, *more]) if more else recorded
    # Scenes made from a held-out scene are held out as well.
    made_from = {name: source for of_root in sources.values() for name, source in of_root.items()}
    learned = [
        number for name in store.scenes if made_from.get(name, name) not in held_out for number in store.frames_of(name)
    ]
    if training.model == ENCODER_NAME:
        return _train_encoder(training, store, learned)
    checked = _HeldOutEvaluation(miniature(training.model), data, held_out)
    judged = checked if judge is None else replace(checked, data=judge, scenes=judge.scene_names(VALIDATION_SPLIT))
    return _train_miniature(training, store, learned, given_weights, checked, judged)


def judge_again(weights: Path, data_root: Path) -> dict[str, Any]:
    """Measure weights that were trained earlier, and write their facts and card anew.

    Args:
        weights: A file of `train_planner`, with its facts beside it.
        data_root: Data set on whose split ``val`` they are measured.

    Returns:
        The facts.

    Raises:
        InputError: If the weights or their facts are missing or do not belong together, or the data cannot be used.
    """
    path = weights.with_suffix(".json")
    facts = read_json(path)
    if not isinstance(facts, dict) or not weights.is_file() or facts.get("sha256") != file_sha256(weights):
        raise InputError(f"{path} does not hold the facts of {weights}; give a file written by train planner")
    small, data = miniature(str(facts.get("model"))), open_data(data_root)
    network = small.build()
    load_weights(network, resolve_checkpoint(small.name, weights))
    facts |= _HeldOutEvaluation(small, data, data.scene_names(VALIDATION_SPLIT)).facts(network.state_dict())
    write_json(path, facts)
    write_bytes(weights.with_suffix(".md"), format_card(small, facts).encode())
    return facts


def _train_encoder(training: PlannerTraining, store: Frames, learned: Sequence[int]) -> dict[str, Any]:
    torch.manual_seed(content_seed("network", ENCODER_NAME, training.seed))
    network = ImageEncoder()
    phase = _scale_phases(_select_phases(training), training)[0]
    weights = fit(phase.objective(network), store, learned, phase.recipe, training.out, device=training.device)
    encoder_weights = {
        name.replace(ENCODER_PYRAMID, PYRAMID): value
        for name, value in weights.items()
        if name.startswith((IMAGE_ENCODER, ENCODER_PYRAMID))
    }
    write_weights(training.out, encoder_weights, _provenance(training, store, encoder_weights))
    # What the card of a miniature that starts from this file names, by the option that it is given with.
    encoder = {name: value for name, value in encoder_weights.items() if name.startswith(IMAGE_ENCODER)}
    keys = {"image_encoder": hash_tensors(encoder), "start_from": hash_tensors(encoder_weights)}
    facts = _collect_metadata(training, store, learned, (phase,), encoder_weights) | {"keys": keys}
    write_json(training.out.with_suffix(".json"), facts)
    training.out.with_suffix(".progress.safetensors").unlink(missing_ok=True)
    return facts


def _train_miniature(
    training: PlannerTraining,
    store: Frames,
    learned: Sequence[int],
    given_weights: Mapping[str, Mapping[str, Tensor]],
    checked: "_HeldOutEvaluation",
    judged: "_HeldOutEvaluation",
) -> dict[str, Any]:
    small = miniature(training.model)
    network = resolve(small.small.untrained)(small.configuration(), _frames_for_anchors(store, learned), training.seed)
    phases = _scale_phases(_select_phases(training), training)
    weights: Mapping[str, Tensor] = {name: value for taken in given_weights.values() for name, value in taken.items()}
    parts = [training.out.with_name(f"{training.out.stem}.{phase.name}.safetensors") for phase in phases]
    start: dict[str, Tensor] = {}
    for phase, part in zip(phases, parts, strict=True):
        objective = phase.objective(network)
        _load_matching(network, weights)
        start = start or {name: value.detach().clone() for name, value in network.state_dict().items()}
        weights = fit(
            objective,
            store,
            learned,
            phase.recipe,
            part,
            check=checked.figures if checked.scenes else None,
            device=training.device,
        )
    weights = {name: _interpolate(start[name], value, training.kept_of_start) for name, value in weights.items()}
    started_from = {option: hash_tensors(taken) for option, taken in given_weights.items()}
    facts = _write_miniature(training, store, learned, phases, weights, judged, started_from)
    for part in parts:
        part.with_suffix(".progress.safetensors").unlink(missing_ok=True)
    return facts


def _write_miniature(
    training: PlannerTraining,
    store: Frames,
    learned: Sequence[int],
    phases: Sequence[Phase],
    weights: Mapping[str, Tensor],
    judged: "_HeldOutEvaluation",
    started_from: Mapping[str, str],
) -> dict[str, Any]:
    """Weights in half precision, and figures of what the file holds."""
    stored = {name: _to_half_precision(value) for name, value in weights.items()}
    write_weights(training.out, stored, _provenance(training, store, stored))
    facts = _collect_metadata(training, store, learned, phases, stored) | {
        "started_from": started_from,
        **({"kept_of_start": training.kept_of_start} if training.kept_of_start else {}),
        **judged.facts(stored),
    }
    write_json(training.out.with_suffix(".json"), facts)
    write_bytes(training.out.with_suffix(".md"), format_card(judged.small, facts).encode())
    return facts


def _interpolate(start: Tensor, learned: Tensor, start_share: float) -> Tensor:
    """The weighted mean of numbers before and after the training; counters are those after it."""
    return (
        torch.lerp(learned, start.to(learned), start_share) if start_share and learned.is_floating_point() else learned
    )


@dataclass(frozen=True, slots=True)
class _HeldOutEvaluation:
    """Measures weights of a miniature on scenes that it does not learn from."""

    small: Model
    data: DataSet
    scenes: Sequence[str]

    def figures(self, weights: Mapping[str, Tensor]) -> dict[str, float]:
        """Figures of plans made from the images."""
        return plan_figures(self._planner(weights), self.data, self.scenes, every=2).as_log()

    def facts(self, weights: Mapping[str, Tensor]) -> dict[str, Any]:
        """Figures with all kinds of images, of constant velocity and of the forecasts; none without scenes."""
        place = {"data": self.data.root.resolve().name, "scenes": list(self.scenes)}
        if not self.scenes:
            return {"figures": {}, "forecasts": None, "seen": None, "lost": {}, "judged_on": place}
        figures = {"constant-velocity": plan_figures(ConstantVelocity(), self.data, self.scenes).as_log()}
        by_images: dict[ImageCondition, EvaluatedPlans] = {}
        for images in ImageCondition:
            if images is ImageCondition.SHUFFLED and len(self.scenes) < 2:
                continue
            judged = by_images[images] = evaluate_plans(self._planner(weights), self.data, self.scenes, images=images)
            figures[images.value] = judged.figures().as_log()
        own = by_images.pop(ImageCondition.OWN)
        forecasts = {"forecasts": own.diagnosed_forecasts(), "seen": own.visible_forecasts()}
        logged = {name: None if forecast is None else forecast.as_log() for name, forecast in forecasts.items()}
        lost = {images.value: asdict(ImageAblation.between(own, other)) for images, other in by_images.items()}
        return {"figures": figures, **logged, "lost": lost, "judged_on": place}

    def _planner(self, weights: Mapping[str, Tensor]) -> Any:
        network = self.small.build()
        network.load_state_dict({name: value.cpu() for name, value in weights.items()})
        return resolve(self.small.planner)(network, name=self.small.name, normalisation=RGB_MEAN_STD, device="cpu")


def _read_start_weights(training: PlannerTraining) -> dict[str, dict[str, Tensor]]:
    """Weights to start from, by the option that named them."""
    by_option: dict[str, dict[str, Tensor]] = {}
    for path in training.start_from:
        tensors = _read_weights(path)
        if training.model != ENCODER_NAME:
            tensors = resolve(miniature(training.model).small.renamed)(tensors)
        by_option["start_from"] = by_option.get("start_from", {}) | tensors
    if training.image_encoder is not None:
        tensors = _read_weights(training.image_encoder)
        chosen = {name: value for name, value in tensors.items() if name.startswith(IMAGE_ENCODER)}
        if not chosen:
            raise InputError(
                f"{training.image_encoder} holds no weights of an image encoder ({IMAGE_ENCODER}...); give another file"
            )
        by_option["image_encoder"] = chosen
    return by_option


def _read_weights(path: Path) -> dict[str, Tensor]:
    return read_tensors(path, what="the weights ", instead="give a .safetensors file")[0]


def _load_matching(network: nn.Module, weights: Mapping[str, Tensor]) -> None:
    """Put weights into a network wherever name and shape agree."""
    state = network.state_dict()
    fitting = {name: value for name, value in weights.items() if name in state and state[name].shape == value.shape}
    if weights and not fitting:
        raise InputError("none of the weights to start from fit this model; give another file")
    network.load_state_dict(fitting, strict=False)


def _frames_for_anchors(store: Frames, learned: Sequence[int]) -> list[TrainingFrame]:
    """Frames from all over the split, without their images."""
    step = max(min(ANCHORS_EVERY, len(learned) // ANCHOR_FRAMES), 1)
    frames = (store.frame(number) for number in learned[::step])
    return [replace(frame, images=torch.empty(0, dtype=torch.uint8)) for frame in frames]


def _select_phases(training: PlannerTraining) -> tuple[Phase, ...]:
    if training.model == ENCODER_NAME:
        phases = (Phase("all", ImageEncoderObjective, _ENCODER_RECIPE),)
    else:
        phases = resolve(miniature(training.model).small.phases)()
    names = [phase.name for phase in phases]
    unknown = next((name for name in training.only if name not in names), None)
    if unknown is not None:
        raise InputError(f"--only {unknown}: the parts of the training of {training.model} are {', '.join(names)}")
    return tuple(phase for phase in phases if not training.only or phase.name in training.only)


def _scale_phases(phases: tuple[Phase, ...], training: PlannerTraining) -> tuple[Phase, ...]:
    total = sum(phase.recipe.steps for phase in phases)
    share = 1.0 if training.steps is None else training.steps / total
    return tuple(phase.changed(share, training.seed, training.learning_rate) for phase in phases)


def _to_half_precision(value: Tensor) -> Tensor:
    return value.half() if value.is_floating_point() and value.numel() >= HALF_FROM else value


def _provenance(training: PlannerTraining, store: Frames, tensors: Mapping[str, Tensor]) -> Provenance:
    return Provenance(
        model=training.model,
        source=f"challenger-bench train planner --model {training.model}",
        source_sha256=store.identity,
        normalisation=RGB_MEAN_STD.name,
        normalisation_from="training",
        licence="Apache-2.0",
        number_types=tuple(sorted({str(value.dtype).removeprefix("torch.") for value in tensors.values()})),
        tool=VERSION,
    )


def _collect_metadata(
    training: PlannerTraining,
    store: Frames,
    learned: Sequence[int],
    phases: Sequence[Phase],
    tensors: Mapping[str, Tensor],
) -> dict[str, Any]:
    return {
        "model": training.model,
        "data": training.data_root.resolve().name,
        "split": training.split,
        **({"adversarial": [root.resolve().name for root in training.adversarial]} if training.adversarial else {}),
        **({"also": [root.resolve().name for root in training.also]} if training.also else {}),
        "frames_identity": store.identity,
        "frames": len(learned),
        "scenes": len(store.scenes),
        "seed": training.seed,
        "phases": {
            phase.name: {"steps": phase.recipe.steps, "learning_rate": phase.recipe.learning_rate} for phase in phases
        },
        "parameters": sum(value.numel() for value in tensors.values() if value.is_floating_point()),
        "sha256": file_sha256(training.out),
        "bytes": training.out.stat().st_size,
        "source": read_source_state(),
        "tool": VERSION,
    }
