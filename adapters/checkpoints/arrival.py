"""Published weights of both kinds come in: checkpoints are converted, folders are kept as they are."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adapters.checkpoints.cache import weights_folder
from adapters.checkpoints.importing import ImportedWeights, fetch_checkpoint, import_checkpoint
from benchmark.weights.catalogue import FOLDERS, PublishedWeights, checkpoint_of
from benchmark.weights.folders import fetch_folder, import_folder, weights_at


@dataclass(frozen=True, slots=True)
class KeptWeights:
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
) -> ImportedWeights | KeptWeights:
    """Check official weights without running anything in them, and keep them.

    Args:
        path: An official ``.pth`` file, or a folder of published weights.
        model: What it must be for; found out if not given.
        normalisation: Name of the pixel normalisation that a checkpoint wants, if the file is wrong on it.
        anchors: For checkpoints that come without (`adapters.checkpoints.importing.import_checkpoint`).

    Returns:
        What is in the cache now.

    Raises:
        InputError: If the file or folder is refused, or the cache cannot be written.
    """
    published = weights_at(path, model)
    if published is not None:
        return KeptWeights(published, import_folder(published, path))
    return import_checkpoint(path, model, normalisation=normalisation, anchors=anchors)


def fetch_weights(name: str, *, normalisation: str | None = None) -> ImportedWeights | KeptWeights:
    """Fetch official weights from the internet and keep them; the same call goes on where it broke off.

    Args:
        name: Model or file name in the catalogue (`adapters.checkpoints.listing.known_weights`).
        normalisation: Name of the pixel normalisation that a checkpoint wants, if the file is wrong on it.

    Returns:
        What is in the cache now.

    Raises:
        InputError: If the name is unknown, or a file cannot be fetched or is not the published one.
    """
    published = next((entry for entry in FOLDERS if entry.name == name), None)
    if published is not None:
        return KeptWeights(published, fetch_folder(published))
    return fetch_checkpoint(checkpoint_of(name), weights_folder(), normalisation=normalisation)
