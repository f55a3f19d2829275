"""Whether tensors are the weights of a model, and of which one."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import torch
from torch import Tensor

from adapters.checkpoints.motion_anchors import FILE as ANCHORS_FILE
from adapters.models import Model, published_models
from benchmark.errors import InputError
from benchmark.report.words import counted


@dataclass(frozen=True, slots=True)
class TensorMatch:
    """Tensors against those that a model needs; all in the order of the model or of the file.

    Attributes:
        agreeing: How many have the right name and shape.
        misshapen: Name, shape in the file, shape in the model.
        mistyped: Names of whole numbers where the model has fractions, or the other way round.
    """

    model: Model
    agreeing: int
    missing: tuple[str, ...]
    extra: tuple[str, ...]
    misshapen: tuple[str, ...]
    mistyped: tuple[str, ...]

    @classmethod
    def of(cls, tensors: Mapping[str, Tensor], model: Model) -> Self:
        """Differences in names, shapes and kinds of numbers; `tensors` are under the model's names (`renamed`)."""
        expected = expected_tensors(model, {name: tuple(tensor.shape) for name, tensor in tensors.items()})
        shared = [name for name in expected if name in tensors]
        misshapen = [name for name in shared if tensors[name].shape != expected[name].shape]
        mistyped = [name for name in shared if tensors[name].is_floating_point() != expected[name].is_floating_point()]
        return cls(
            model=model,
            agreeing=len(set(shared) - set(misshapen) - set(mistyped)),
            missing=tuple(name for name in expected if name not in tensors),
            extra=tuple(name for name in tensors if name not in expected),
            misshapen=tuple(
                f"{name} {tuple(tensors[name].shape)} instead of {tuple(expected[name].shape)}" for name in misshapen
            ),
            mistyped=tuple(mistyped),
        )

    @property
    def fits(self) -> bool:
        """Whether these are weights of the model."""
        return not (self.missing or self.extra or self.misshapen or self.mistyped)

    @property
    def lacks_anchors(self) -> bool:
        """Whether nothing is wrong but that the anchors are in a file of their own."""
        return replace(self, missing=()).fits and self.missing == (self.model.net.anchors,)

    def differences(self) -> str:
        """All kinds of differences in words, with the first example of each."""
        kinds = (
            (self.missing, "missing"),
            (self.extra, "too many"),
            (self.misshapen, "of another shape"),
            (self.mistyped, "of another kind of number"),
        )
        return "; ".join(f"{len(names)} {what} (first: {names[0]})" for names, what in kinds if names)


def expected_tensors(model: Model, shapes: Mapping[str, Sequence[int]]) -> dict[str, Tensor]:
    """Names, shapes and types of all tensors of a model, in the network's order and without their memory.

    `shapes` are those of the tensors that the network is for, by name.
    """
    return dict(model.build(shapes, device="meta").state_dict())


def renamed(tensors: Mapping[str, Tensor], model: Model) -> dict[str, Tensor]:
    """Tensors under the names that a model has now, without those that it is known not to need."""
    found = {}
    for name, tensor in tensors.items():
        for pattern, replacement in model.net.renamed:
            name = re.sub(pattern, replacement, name)
        if not any(re.search(pattern, name) for pattern in model.net.ignored):
            found[name] = tensor
    return found


def matched(path: Path, tensors: Mapping[str, Tensor], wanted: str | None) -> tuple[Model, dict[str, Tensor]]:
    """The model that tensors are the weights of, and the tensors under its names, in its order and its number types.

    Tensors with NaN or infinity are refused, as are those that fit no model or not the `wanted` one.
    """
    compared = [TensorMatch.of(renamed(tensors, model), model) for model in published_models().values()]
    fitting = [found for found in compared if found.fits and wanted in (None, found.model.name)]
    if not fitting:
        raise InputError(_does_not_fit(path, compared, wanted))
    model = fitting[0].model
    found = renamed(tensors, model)
    expected = expected_tensors(model, {name: tuple(tensor.shape) for name, tensor in found.items()})
    converted = {name: found[name].to(like.dtype).contiguous() for name, like in expected.items()}
    broken = [name for name, tensor in converted.items() if not bool(torch.isfinite(tensor).all())]
    if broken:
        raise InputError(
            f"{path}: {counted(len(broken), 'tensor')} hold NaN or infinity (first: {broken[0]}); the file is "
            "damaged or the "
            "training diverged, get another"
        )
    return model, converted


def _does_not_fit(path: Path, compared: Sequence[TensorMatch], wanted: str | None) -> str:
    other = next((found.model.name for found in compared if found.fits), None)
    if other is not None:
        return f"{path} holds the weights of {other}, not of {wanted}; use it with --model {other}"
    bare = next((found for found in compared if found.lacks_anchors and wanted in (None, found.model.name)), None)
    if bare is not None:
        return (
            f"{path} comes without motion anchors, which {bare.model.name} has in a file of its own; get it "
            f"(challenger-bench weights list), then run: challenger-bench weights import {path.name} "
            f"--anchors {ANCHORS_FILE}"
        )
    by_name = {found.model.name: found for found in compared}
    nearest = by_name[wanted] if wanted else max(compared, key=lambda found: found.agreeing)
    if not nearest.agreeing:
        target = wanted or f"any of {', '.join(by_name)}"
        return f"{path} has no tensor that belongs to {target}; it is a checkpoint of something else"
    return (
        f"{path} is not a checkpoint of {nearest.model.name}"
        f"{'' if wanted else ', which it resembles most'}: of its tensors, {nearest.differences()}; get the official "
        "file of this version of the model (challenger-bench weights list)"
    )
