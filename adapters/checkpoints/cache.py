"""Imported weights on disk, one safetensors file a checkpoint, and the listing of published and imported weights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, ValidationError
from torch import Tensor, nn

from benchmark.errors import InputError
from benchmark.machine.workspace import weights_root
from benchmark.report.terminal import wrap_text
from benchmark.weights.catalogue import CHECKPOINTS, FOLDERS, PublishedWeights
from benchmark.weights.folders import find_cached_folder
from benchmark.weights.tensors import read_header, read_tensors, write_tensors

_AGAIN: Final = "import or fetch them again"


class Provenance(BaseModel):
    """Origin of weights, kept in the header of their file.

    Attributes:
        normalisation: Which pixel values they want (`adapters.camera_inputs.NORMALISATIONS`).
        normalisation_from: Source of that: ``configuration`` of the file itself, ``publication`` or ``user``.
        licence: Of the weights, as far as is known.
        number_types: Number types in the source; the file here has the model's.
        anchors_sha256: Of the anchors that they were given, if they came without.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    model: str
    source: str
    source_sha256: str
    normalisation: str
    normalisation_from: str
    licence: str
    number_types: tuple[str, ...]
    anchors_sha256: str | None = None
    tool: str


def weights_folder() -> Path:
    """Folder of imported weights."""
    return weights_root()


def weights_path(folder: Path, provenance: Provenance) -> Path:
    """File of imported weights, ``MODEL-NORMALISATION-HASH.safetensors``: source, then anchors."""
    hashes = (provenance.source_sha256, provenance.anchors_sha256)
    parts = [provenance.model, provenance.normalisation, *(digest[:16] for digest in hashes if digest is not None)]
    return folder / f"{'-'.join(parts)}.safetensors"


def write_weights(path: Path, tensors: Mapping[str, Tensor], provenance: Provenance) -> None:
    """Write weights, whole or not at all. One metadata entry, because the order of several is not fixed."""
    write_tensors(path, tensors, provenance.model_dump(mode="json"))


def read_provenance(path: Path) -> Provenance:
    """Provenance that a weights file says of itself; the tensors are not read."""
    return _provenance(path, read_header(path, instead=_AGAIN)[1])


def read_shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Shapes of the tensors in a weights file; the tensors are not read."""
    return read_header(path, instead=_AGAIN)[0]


def load_weights(network: nn.Module, path: Path) -> Provenance:
    """Put weights into a network; all names and shapes must agree."""
    tensors, facts = read_tensors(path, instead=_AGAIN)
    provenance = _provenance(path, facts)
    try:
        network.load_state_dict(tensors, strict=True)
    except RuntimeError as error:
        reason = str(error).splitlines()[-1].strip()
        raise InputError(f"the weights in {path} do not fit {provenance.model}: {reason}; import them again") from error
    return provenance


def cached_weights(folder: Path, model: str | None = None) -> dict[Path, Provenance]:
    """Provenance of imported weights by file, in order of names; a damaged file counts as absent."""
    weights = {}
    for path in sorted(folder.glob("*.safetensors")):
        try:
            provenance = read_provenance(path)
        except InputError:
            continue
        if model in (None, provenance.model):
            weights[path] = provenance
    return weights


def _provenance(path: Path, facts: Any) -> Provenance:
    try:
        return Provenance.model_validate(facts)
    except ValidationError as error:
        raise InputError(
            f"{path} does not name the model of its weights; import the official .pth file with: "
            "challenger-bench weights import PATH"
        ) from error


@dataclass(frozen=True, slots=True)
class WeightsListing:
    """Published weights. `imported` is what has been imported for a model, from its file or another, or the folder."""

    weights: PublishedWeights
    imported: dict[Path, Provenance | None]

    def as_json(self) -> dict[str, Any]:
        """Plain values; what checkpoints and folders both have has the same name."""
        known = self.weights
        imported = [
            {"path": str(path), **({} if provenance is None else provenance.model_dump(mode="json"))}
            for path, provenance in self.imported.items()
        ]
        if not known.is_folder:
            checkpoint, *companions = known.files
            return {
                "model": known.name,
                "file": checkpoint.name,
                "page": checkpoint.page,
                "url": checkpoint.url,
                "licence": known.licence,
                "size_bytes": checkpoint.size_bytes,
                "sha256": checkpoint.sha256,
                "with": [{"file": file.name, "page": file.page, "url": file.url} for file in companions],
                "imported": imported,
            }
        return {
            "model": known.name,
            "repository": known.repository,
            "revision": known.revision,
            "page": known.address,
            "licence": known.licence,
            "used_by": known.used_by,
            "size": known.size_text,
            "files": [
                {"name": file.name, "url": known.url(file), "size_bytes": file.size_bytes, "sha256": file.sha256}
                for file in known.files
            ],
            "imported": imported,
        }

    def plain(self) -> str:
        """A few lines of text."""
        known = self.weights
        if known.is_folder:
            head = f"{known.name}: {known.repository} at {known.revision}, {known.size_text}, for {known.used_by}"
            lines = [head, f"  {known.address}", f"  {known.licence}", *(f"  in {path}" for path in self.imported)]
        else:
            checkpoint, *companions = known.files
            size = "size unknown" if checkpoint.size_bytes is None else f"{checkpoint.size_bytes / 1e6:.0f} MB"
            digest = "SHA-256 unknown" if checkpoint.sha256 is None else f"SHA-256 {checkpoint.sha256}"
            lines = [f"{known.name}: {checkpoint.name}, {size}, {digest}", f"  {checkpoint.page}", f"  {known.licence}"]
            lines += [f"  needs {file.name}: {file.page}" for file in companions]
            lines += [
                f"  imported from {provenance.source} ({provenance.source_sha256[:16]}), "
                f"{provenance.normalisation}: {path}"
                for path, provenance in self.imported.items()
                if provenance is not None
            ]
        every = lines if self.imported else [*lines, "  not imported"]
        return "\n".join(line for text in every for line in _wrap(text))


def known_weights(
    cache: Path | None = None, entries: Sequence[PublishedWeights] = (*CHECKPOINTS, *FOLDERS)
) -> tuple[WeightsListing, ...]:
    """Published weights and what is here of them.

    Args:
        cache: Folder of weights; the user's by default.
        entries: Those to look for.

    Returns:
        One for each entry.
    """
    return tuple(WeightsListing(entry, _find_imported(entry, cache or weights_folder())) for entry in entries)


def _wrap(text: str) -> list[str]:
    indent = text[: len(text) - len(text.lstrip())]
    return wrap_text(text.strip(), indent=indent, hanging="  ")


def _find_imported(weights: PublishedWeights, cache: Path) -> dict[Path, Provenance | None]:
    if not weights.is_folder:
        return dict(cached_weights(cache, weights.name))
    folder = find_cached_folder(weights, cache)
    return {} if folder is None else {folder: None}
