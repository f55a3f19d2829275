"""A foreign checkpoint becomes weights of ours, once; ``--checkpoint`` of either form becomes a weights file."""

import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from torch import Tensor

from adapters.camera_inputs import NORMALISATIONS, normalisation_of
from adapters.checkpoints.anchor_files import read_anchors
from adapters.checkpoints.cache import (
    Provenance,
    cached_weights,
    read_provenance,
    weights_folder,
    weights_path,
    write_weights,
)
from adapters.checkpoints.matching import matched
from adapters.checkpoints.motion_anchors import anchors_beside, published_beside, with_motion_anchors
from adapters.checkpoints.stand_in import no_weights, official_weights, what_to_get
from adapters.models import Model, published_model
from adapters.networks.sparse.anchors import with_anchors
from benchmark.constants import VERSION
from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256, only_writer
from benchmark.report.words import counted
from benchmark.untrusted.files import open_file
from benchmark.untrusted.limits import CHECKPOINT, PICKLE
from benchmark.weights.catalogue import PublishedWeights
from benchmark.weights.fetch import fetch_files
from benchmark.weights.foreign import read_checkpoint

_NORM: Final = re.compile(
    r"img_norm_cfg\s*=\s*dict\(\s*mean\s*=\s*\[([^\]]*)\]\s*,\s*std\s*=\s*\[([^\]]*)\]\s*,\s*to_rgb\s*=\s*(True|False)"
)


@dataclass(frozen=True, slots=True)
class ImportedWeights:
    """Weights in the cache; `tensors` and `parameters` say how many of each."""

    path: Path
    provenance: Provenance
    tensors: int
    parameters: int

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        facts = self.provenance.model_dump(mode="json")
        return {"path": str(self.path), "tensors": self.tensors, "parameters": self.parameters, **facts}

    def sentence(self) -> str:
        """Sentence about the weights."""
        known = self.provenance
        return (
            f"{self.path}: {known.model}, {counted(self.tensors, 'tensor')}, {self.parameters / 1e6:.1f} M numbers, "
            f"pixel values {known.normalisation} (said by: {known.normalisation_from})"
        )


def import_checkpoint(
    path: Path,
    model: str | None = None,
    cache: Path | None = None,
    *,
    normalisation: str | None = None,
    anchors: Path | None = None,
) -> ImportedWeights:
    """Check an official checkpoint and keep its weights as safetensors.

    Args:
        model: The model that it must be for, or ``None`` to find out.
        normalisation: Name of the pixel normalisation that the weights want, or ``None``: what the training
            configuration in the file says, else what the published files want.
        anchors: Anchors for weights that come without them: of ``weights anchors``, or UniAD's published pickle. Where
            that lies beside a checkpoint of UniAD, it need not be named.

    Returns:
        The weights file, which is the same for the same checkpoint.

    Raises:
        InputError: If the file is refused (`read_checkpoint`), fits no model or not the one asked for, was trained with
            other anchors, wants pixel values that are not known, or the cache cannot be written.
    """
    if model is not None:
        published_model(model)
    checkpoint = read_checkpoint(path)
    anchors = anchors or anchors_beside(path, checkpoint.tensors)
    found, tensors = matched(path, _with_anchors(path, checkpoint.tensors, anchors), model)
    wanted, said_by = _normalisation(path, checkpoint.configuration, found, normalisation)
    digest = file_sha256(path)
    official = official_weights(found.name)
    provenance = Provenance(
        model=found.name,
        source=path.name,
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
    return ImportedWeights(target, provenance, len(tensors), sum(tensor.numel() for tensor in tensors.values()))


def fetch_checkpoint(weights: PublishedWeights, cache: Path, *, normalisation: str | None = None) -> ImportedWeights:
    """Fetch an official checkpoint and what it needs, check and import them; the fetched files themselves are not kept.

    The same command goes on where a download broke off. `weights` is of `benchmark.weights.catalogue.checkpoint_of`.
    """
    folder = cache / f".fetching-{weights.name}"
    with only_writer(folder):
        fetch_files(weights, folder)
        try:
            return import_checkpoint(folder / weights.files[0].name, weights.name, cache, normalisation=normalisation)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def resolve_checkpoint(model: str, checkpoint: Path | None, cache: Path | None = None) -> Path:
    """The weights file for a model, from what ``--checkpoint`` says or from what has been imported.

    `checkpoint` is a ``.pth`` file (imported on the way, once), a ``.safetensors`` file of ours, or ``None``. An
    `InputError` says that there are no weights (what to get and where), several to choose from, or that they are for
    another model.
    """
    folder = cache or weights_folder()
    if checkpoint is None:
        return _imported(model, folder)
    if not checkpoint.is_file():
        raise InputError(f"there is no checkpoint {checkpoint}; {what_to_get(model)}")
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
    known = {path: found for path, found in cached_weights(folder, model).items() if found.source_sha256 == digest}
    beside = published_beside(checkpoint) if published_model(model).net.anchors else None
    if beside is not None:
        open_file(beside, PICKLE).close()
        those = (None, file_sha256(beside))
        known = {path: found for path, found in known.items() if found.anchors_sha256 in those}
    return _only(model, known) if known else import_checkpoint(checkpoint, model, folder).path


def _with_anchors(path: Path, tensors: Mapping[str, Tensor], anchors: Path | None) -> Mapping[str, Tensor]:
    if anchors is None:
        return tensors
    if anchors.suffix != ".safetensors":
        return with_motion_anchors(path, tensors, anchors)
    return with_anchors(tensors, read_anchors(anchors))


def _imported(model: str, folder: Path) -> Path:
    known = cached_weights(folder, model)
    if not known:
        raise no_weights(model)
    return _only(model, known)


def _only(model: str, known: Mapping[Path, Provenance]) -> Path:
    if len(known) > 1:
        some = ", ".join(f"{path} (from {found.source})" for path, found in known.items())
        raise InputError(f"there are several weights for {model}: {some}; choose one with --checkpoint")
    return next(iter(known))


def _normalisation(path: Path, configuration: str, model: Model, asked: str | None) -> tuple[str, str]:
    """Normalisation of the pixels that the weights want, and who says so."""
    if asked is not None:
        return normalisation_of(asked).name, "user"
    found = _NORM.search(configuration)
    if found is None:
        return model.net.published_normalisation, "publication"
    mean, std = _numbers(found[1]), _numbers(found[2])
    for name, variant in NORMALISATIONS.items():
        if mean == list(variant.mean) and std == list(variant.std) and (found[3] == "True") == variant.rgb:
            return name, "configuration"
    raise InputError(
        f"{path} was trained with pixel values that no normalisation here has ({' '.join(found[0].split())}); say "
        f"which to use with --normalisation, one of {', '.join(NORMALISATIONS)}"
    )


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"[-+.\deE]+", text)]
