"""Planners of the table with their weights; published checkpoints are converted, folders are kept as they are."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adapters.as_published import select_options
from adapters.camera_inputs import find_normalisation
from adapters.checkpoints.cache import load_weights, read_shapes, weights_folder
from adapters.checkpoints.checkpoint_import import (
    ImportedWeights,
    fetch_checkpoint,
    import_checkpoint,
    resolve_checkpoint,
)
from adapters.models import Model, resolve
from adapters.planner import NativePlanner
from benchmark.errors import InputError
from benchmark.machine.devices import Precision
from benchmark.machine.storage import file_sha256
from benchmark.weights.catalogue import FOLDERS, PublishedWeights, find_checkpoint
from benchmark.weights.folders import fetch_folder, import_folder, recognise_weights


@dataclass(frozen=True, slots=True)
class CachedWeightsFolder:
    """A folder of published weights in the cache."""

    weights: PublishedWeights
    path: Path

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"model": self.weights.name, "path": str(self.path)}

    def sentence(self) -> str:
        """Sentence about the folder and its contents."""
        return f"{self.path}: {self.weights.name}, for {self.weights.used_by}"


def import_weights(
    path: Path, model: str | None = None, *, normalisation: str | None = None, anchors: Path | None = None
) -> ImportedWeights | CachedWeightsFolder:
    """Check official weights without running anything in them, and keep them.

    Args:
        path: An official ``.pth`` file, or a folder of published weights.
        model: Model that it must be for; detected if not given.
        normalisation: Name of the pixel normalisation that a checkpoint wants, if the file is wrong on it.
        anchors: For checkpoints that come without (`adapters.checkpoints.checkpoint_import.import_checkpoint`).

    Returns:
        The imported weights in the cache.

    Raises:
        InputError: If the file or folder is refused, or the cache cannot be written.
    """
    published = recognise_weights(path, model)
    if published is not None:
        return CachedWeightsFolder(published, import_folder(published, path))
    return import_checkpoint(path, model, normalisation=normalisation, anchors=anchors)


def fetch_weights(name: str, *, normalisation: str | None = None) -> ImportedWeights | CachedWeightsFolder:
    """Fetch official weights from the internet and keep them; the same call goes on where it broke off.

    Args:
        name: Model or file name in the catalogue (`adapters.checkpoints.cache.known_weights`).
        normalisation: Name of the pixel normalisation that a checkpoint wants, if the file is wrong on it.

    Returns:
        The fetched weights in the cache.

    Raises:
        InputError: If the name is unknown, or a file cannot be fetched or is not the published one.
    """
    published = next((entry for entry in FOLDERS if entry.name == name), None)
    if published is not None:
        return CachedWeightsFolder(published, fetch_folder(published))
    return fetch_checkpoint(find_checkpoint(name), weights_folder(), normalisation=normalisation)


def build_native_planner(
    model: Model,
    checkpoint: Path | None = None,
    seed: int = 0,
    device: str = "auto",
    precision: Precision = "float32",
    as_published: Sequence[str] = (),
) -> NativePlanner[Any]:
    """A network under test.

    Without a `checkpoint` (`resolve_checkpoint`) a miniature has the weights of this package, and the others what has
    been imported. `seed` is of the noise, where there is some; ``bfloat16`` is of the matrix products.
    """
    options = select_options(model.name, model.net.as_published, as_published)
    if model.requires is not None:
        resolve(model.requires)()
    path = _weights_file(model, checkpoint)
    network = model.build(read_shapes(path) if model.net.fitted else None, seed=seed, as_published=options)
    provenance = load_weights(network, path)
    planner: NativePlanner[Any] = resolve(model.planner)(
        network,
        name=model.name,
        normalisation=find_normalisation(provenance.normalisation),
        weights_sha256=file_sha256(path),
        settings={"weights": provenance.model_dump(mode="json")},
        native_protocol=model.native_protocol,
        device=device,
        precision=precision,
        as_published=options,
    )
    return planner


def _weights_file(model: Model, checkpoint: Path | None) -> Path:
    if model.miniature is None or checkpoint is not None:
        return resolve_checkpoint(model.weights or model.name, checkpoint)
    if not model.packaged.is_file():
        raise InputError(
            f"the weights of {model.name} are missing in this installation; train them with: challenger-bench train "
            f"planner --model {model.name}, and give the file with --checkpoint"
        )
    return resolve_checkpoint(model.name, model.packaged)
