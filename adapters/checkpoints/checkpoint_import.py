"""Import of foreign checkpoints, matched with the tensors of known models, as weights files."""

import re
import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import torch
from torch import Tensor

from adapters.camera_inputs import NORMALISATIONS, find_normalisation
from adapters.checkpoints.anchor_files import FILE as ANCHORS_FILE
from adapters.checkpoints.anchor_files import (
    add_motion_anchors,
    find_anchors_beside,
    find_published_beside,
    read_anchors,
)
from adapters.checkpoints.cache import (
    Provenance,
    cached_weights,
    read_provenance,
    weights_folder,
    weights_path,
    write_weights,
)
from adapters.checkpoints.stand_in import describe_how_to_get, missing_weights_error, official_weights
from adapters.models import Model, published_model, published_models
from adapters.networks.sparse.anchors import add_anchors
from benchmark.constants import VERSION
from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256, lock_folder
from benchmark.report.words import pluralise
from benchmark.untrusted.files import CHECKPOINT, PICKLE, open_file
from benchmark.weights.catalogue import PublishedWeights
from benchmark.weights.fetch import fetch_files
from benchmark.weights.folders import read_checkpoint


@dataclass(frozen=True, slots=True)
class TensorMatch:
    """Tensors against those that a model needs, in the order of the model or of the file.

    `misshapen` are shape in the file and shape in the model, by name; `mistyped` whole numbers where the model has
    fractions, or the other way round; `parts` parts of the model of which the file has nothing.
    """

    model: Model
    agreeing: int
    missing: tuple[str, ...]
    extra: tuple[str, ...]
    misshapen: Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]]
    mistyped: tuple[str, ...]
    parts: tuple[str, ...] = ()

    @classmethod
    def of(cls, tensors: Mapping[str, Tensor], model: Model) -> Self:
        """Differences in names, shapes and number types; `tensors` are under the model's names (`rename_tensors`)."""
        expected = expected_tensors(model, {name: tuple(tensor.shape) for name, tensor in tensors.items()})
        shared = [name for name in expected if name in tensors]
        misshapen = [name for name in shared if tensors[name].shape != expected[name].shape]
        mistyped = [name for name in shared if tensors[name].is_floating_point() != expected[name].is_floating_point()]
        return cls(
            model=model,
            agreeing=len(set(shared) - set(misshapen) - set(mistyped)),
            missing=tuple(name for name in expected if name not in tensors),
            extra=tuple(name for name in tensors if name not in expected),
            misshapen={name: (tuple(tensors[name].shape), tuple(expected[name].shape)) for name in misshapen},
            mistyped=tuple(mistyped),
            parts=_list_absent_parts(tensors, [name for name in expected if name != model.net.anchors]),
        )

    @property
    def fits(self) -> bool:
        """Whether the tensors are weights of the model."""
        return not (self.missing or self.extra or self.misshapen or self.mistyped)

    @property
    def lacks_anchors(self) -> bool:
        """Whether the only difference is that the anchors are in a separate file."""
        return replace(self, missing=()).fits and self.missing == (self.model.net.anchors,)

    def differences(self) -> str:
        """All kinds of differences in words, with the first example of each."""
        shapes = [f"{name} {have} instead of {want}" for name, (have, want) in self.misshapen.items()]
        kinds = (
            (self.missing, "missing"),
            (self.extra, "too many"),
            (shapes, "of another shape"),
            (self.mistyped, "of another kind of number"),
        )
        return "; ".join(f"{len(names)} {kind} (first: {names[0]})" for names, kind in kinds if names)

    def meaning(self) -> str:
        """What the differences mean, as far as they tell, with a comma before; for a sentence on the file."""
        meanings = []
        classes = {
            name: (have[0], want[0])
            for name, (have, want) in self.misshapen.items()
            if _CLASSIFIER.search(name) and have[1:] == want[1:] and have and want
        }
        if classes:
            name, (have, want) = next(iter(classes.items()))
            meanings.append(f"it was trained for other classes ({name.rpartition('.')[0]} tells {have}, not {want})")
        if self.parts:
            more = f" and {len(self.parts) - 3} more parts" if len(self.parts) > 3 else ""
            meanings.append(
                f"it has nothing of {', '.join(self.parts[:3])}{more}, as files of an earlier stage of training"
            )
        return "".join(f", so {meaning}" for meaning in meanings)


_CLASSIFIER: Final = re.compile(r"(^|[._])cls|class")


def _list_absent_parts(tensors: Collection[str], expected: Sequence[str]) -> tuple[str, ...]:
    """Parts of a model, by the first one or two words of names, of which there is not one tensor."""
    absent: list[str] = []
    for words in (1, 2):
        own = [name for name in expected if not any(name.startswith(f"{part}.") for part in absent)]
        parts = {".".join(name.split(".")[:words]) for name in own}
        present = {".".join(name.split(".")[:words]) for name in tensors}
        absent += sorted(parts - present - set(own))
    return tuple(absent)


def expected_tensors(model: Model, shapes: Mapping[str, Sequence[int]]) -> dict[str, Tensor]:
    """Names, shapes and types of a model's tensors, without their memory; `shapes` are those of the checkpoint."""
    return dict(model.build(shapes, device="meta").state_dict())


def rename_tensors(tensors: Mapping[str, Tensor], model: Model) -> dict[str, Tensor]:
    """Tensors under the names that a model has now, without those that it is known not to need."""
    by_name = {}
    for name, tensor in tensors.items():
        for pattern, replacement in model.net.renamed:
            name = re.sub(pattern, replacement, name)
        if not any(re.search(pattern, name) for pattern in model.net.ignored):
            by_name[name] = tensor
    return by_name


def match_model(path: Path, tensors: Mapping[str, Tensor], wanted: str | None) -> tuple[Model, dict[str, Tensor]]:
    """The model that tensors are the weights of, and the tensors under its names, in its order and its number types.

    Tensors with NaN or infinity are refused, as are those that fit no model or not the `wanted` one.
    """
    compared = [TensorMatch.of(rename_tensors(tensors, model), model) for model in published_models().values()]
    fitting = [candidate for candidate in compared if candidate.fits and wanted in (None, candidate.model.name)]
    if not fitting:
        raise InputError(_describe_mismatch(path, compared, wanted))
    model = fitting[0].model
    candidate = rename_tensors(tensors, model)
    expected = expected_tensors(model, {name: tuple(tensor.shape) for name, tensor in candidate.items()})
    converted = {name: candidate[name].to(like.dtype).contiguous() for name, like in expected.items()}
    broken = [name for name, tensor in converted.items() if not bool(torch.isfinite(tensor).all())]
    if broken:
        raise InputError(
            f"{path}: {pluralise(len(broken), 'tensor')} hold NaN or infinity (first: {broken[0]}); the file is "
            "damaged or the training diverged; get another file"
        )
    return model, converted


def _describe_mismatch(path: Path, compared: Sequence[TensorMatch], wanted: str | None) -> str:
    other = next((match.model.name for match in compared if match.fits), None)
    if other is not None:
        return f"{path} holds the weights of {other}, not of {wanted}; use it with --model {other}"
    bare = next((match for match in compared if match.lacks_anchors and wanted in (None, match.model.name)), None)
    if bare is not None:
        return (
            f"{path} comes without motion anchors, which {bare.model.name} has in a separate file; get it "
            f"(challenger-bench weights list), then run: challenger-bench weights import {path.name} "
            f"--anchors {ANCHORS_FILE}"
        )
    by_name = {match.model.name: match for match in compared}
    nearest = by_name[wanted] if wanted else max(compared, key=lambda found: found.agreeing)
    if not nearest.agreeing:
        target = wanted or f"any of {', '.join(by_name)}"
        return f"{path} has no tensor of {target}; give a checkpoint of one{_OWN_NETWORK}"
    return (
        f"{path} is not a checkpoint of {nearest.model.name}"
        f"{'' if wanted else ', which it resembles most'}: of its tensors, {nearest.differences()}{nearest.meaning()}; "
        f"get the official file of this version of the model (challenger-bench weights list){_OWN_NETWORK}"
    )


_OWN_NETWORK: Final = (
    ", or let a network of your own run in its own code: challenger-bench eval --results FILE scores the result file "
    "of its evaluation, challenger-bench eval --model NAME=http://HOST:PORT asks it over HTTP (docs/planners.md)"
)


_NORM: Final = re.compile(
    r"img_norm_cfg\s*=\s*dict\(\s*mean\s*=\s*\[([^\]]*)\]\s*,\s*std\s*=\s*\[([^\]]*)\]\s*,\s*to_rgb\s*=\s*(True|False)"
)


@dataclass(frozen=True, slots=True)
class ImportedWeights:
    """Weights in the cache; `tensors` and `parameters` say how many of each, `note` which of several copies."""

    path: Path
    provenance: Provenance
    tensors: int
    parameters: int
    note: str = ""

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        facts = self.provenance.model_dump(mode="json")
        return {"path": str(self.path), "tensors": self.tensors, "parameters": self.parameters, **facts}

    def sentence(self) -> str:
        """Sentence about the weights."""
        known = self.provenance
        return (
            f"{self.path}: {known.model}, {pluralise(self.tensors, 'tensor')}, {self.parameters / 1e6:.1f} M "
            f"parameters, pixel values {known.normalisation} (source: {known.normalisation_from})"
            f"{self.note and f'; {self.note}'}"
        )


def import_checkpoint(
    path: Path,
    model: str | None = None,
    cache: Path | None = None,
    *,
    normalisation: str | None = None,
    anchors: Path | None = None,
) -> ImportedWeights:
    """Check an official checkpoint and keep its weights as safetensors; the same checkpoint gives the same file.

    Args:
        model: The model that it must be for, or ``None`` to find out.
        normalisation: Name of the pixel normalisation that the weights want, or ``None``: what the training
            configuration in the file says, else what the published files want.
        anchors: For weights without them: of ``weights anchors``, or UniAD's published pickle, which is found by itself
            beside a checkpoint of UniAD.

    Raises:
        InputError: If the file is refused (`read_checkpoint`), fits no model or not the one asked for, was trained with
            other anchors, wants pixel values that are not known, or the cache cannot be written.
    """
    if model is not None:
        published_model(model)
    checkpoint = read_checkpoint(path)
    anchors = anchors or find_anchors_beside(path, checkpoint.tensors)
    matched_model, tensors = match_model(path, _add_anchors(path, checkpoint.tensors, anchors), model)
    wanted, said_by = _find_normalisation(path, checkpoint.configuration, matched_model, normalisation)
    digest = file_sha256(path)
    official = official_weights(matched_model.name)
    provenance = Provenance(
        model=matched_model.name,
        source=", ".join(filter(None, (path.name, checkpoint.note))),
        source_sha256=digest,
        normalisation=wanted,
        normalisation_from=said_by,
        licence=official.licence if official else "unknown",
        number_types=tuple(sorted({str(t.dtype).removeprefix("torch.") for t in checkpoint.tensors.values()})),
        anchors_sha256=None if anchors is None else file_sha256(anchors),
        tool=VERSION,
    )
    target = weights_path(cache or weights_folder(), provenance)
    write_weights(target, tensors, provenance)
    parameters = sum(tensor.numel() for tensor in tensors.values())
    return ImportedWeights(target, provenance, len(tensors), parameters, checkpoint.note)


def fetch_checkpoint(weights: PublishedWeights, cache: Path, *, normalisation: str | None = None) -> ImportedWeights:
    """Fetch and import an official checkpoint and what it needs, resuming if interrupted; no fetched file is kept."""
    folder = cache / f".fetching-{weights.name}"
    with lock_folder(folder):
        fetch_files(weights, folder)
        try:
            return import_checkpoint(folder / weights.files[0].name, weights.name, cache, normalisation=normalisation)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def resolve_checkpoint(model: str, checkpoint: Path | None, cache: Path | None = None) -> Path:
    """The weights file for a model: of ``--checkpoint`` (a ``.pth`` file is imported once), or imported before.

    An `InputError` says that there are no weights (what to get and where), several to choose from, or that they are for
    another model.
    """
    folder = cache or weights_folder()
    if checkpoint is None:
        return _find_imported(model, folder)
    if not checkpoint.is_file():
        raise InputError(f"there is no checkpoint {checkpoint}; {describe_how_to_get(model)}")
    if checkpoint.suffix == ".safetensors":
        provenance = read_provenance(checkpoint)
        if provenance.model != model:
            raise InputError(
                f"{checkpoint} holds the weights of {provenance.model}, not of {model}; use it with --model "
                f"{provenance.model}"
            )
        return checkpoint
    open_file(checkpoint, CHECKPOINT).close()
    digest = file_sha256(checkpoint)
    known = {path: origin for path, origin in cached_weights(folder, model).items() if origin.source_sha256 == digest}
    beside = find_published_beside(checkpoint) if published_model(model).net.anchors else None
    if beside is not None:
        open_file(beside, PICKLE).close()
        anchor_digests = (None, file_sha256(beside))
        known = {path: origin for path, origin in known.items() if origin.anchors_sha256 in anchor_digests}
    return _require_one(model, known) if known else import_checkpoint(checkpoint, model, folder).path


def _add_anchors(path: Path, tensors: Mapping[str, Tensor], anchors: Path | None) -> Mapping[str, Tensor]:
    if anchors is None:
        return tensors
    if anchors.suffix != ".safetensors":
        return add_motion_anchors(path, tensors, anchors)
    return add_anchors(tensors, read_anchors(anchors))


def _find_imported(model: str, folder: Path) -> Path:
    known = cached_weights(folder, model)
    if not known:
        raise missing_weights_error(model)
    return _require_one(model, known)


def _require_one(model: str, known: Mapping[Path, Provenance]) -> Path:
    if len(known) > 1:
        listing = ", ".join(f"{path} (from {provenance.source})" for path, provenance in known.items())
        raise InputError(f"there are several weights for {model}: {listing}; choose one with --checkpoint")
    return next(iter(known))


def _find_normalisation(path: Path, configuration: str, model: Model, requested: str | None) -> tuple[str, str]:
    """Normalisation of the pixels that the weights want, and its source (`Provenance.normalisation_from`)."""
    if requested is not None:
        return find_normalisation(requested).name, "user"
    match = _NORM.search(configuration)
    if match is None:
        return model.net.published_normalisation, "publication"
    mean, std = _numbers(match[1]), _numbers(match[2])
    for name, variant in NORMALISATIONS.items():
        if mean == list(variant.mean) and std == list(variant.std) and (match[3] == "True") == variant.rgb:
            return name, "configuration"
    raise InputError(
        f"{path} was trained with pixel values of an unknown normalisation ({' '.join(match[0].split())}); choose "
        f"one with --normalisation: {', '.join(NORMALISATIONS)}"
    )


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"[-+.\deE]+", text)]
