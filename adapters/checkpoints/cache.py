"""Imported weights on disk: one safetensors file a checkpoint, which says where it comes from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, ValidationError
from torch import Tensor, nn

from benchmark.errors import InputError
from benchmark.machine.workspace import weights_root
from benchmark.weights.tensors import read_header, read_tensors, write_tensors

_AGAIN: Final = "import or fetch them again"


class Provenance(BaseModel):
    """Origin of weights, kept in the header of their file.

    Attributes:
        normalisation: Which pixel values they want (`adapters.camera_inputs.NORMALISATIONS`).
        normalisation_from: Who says so: ``configuration`` of the file itself, ``publication`` or ``user``.
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
    parts = [provenance.model, provenance.normalisation, *(found[:16] for found in hashes if found is not None)]
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
    """Provenance of imported weights by file, in order of names; of one model only where `model` is given.

    A damaged file counts as absent; importing makes it again.
    """
    found = {}
    for path in sorted(folder.glob("*.safetensors")):
        try:
            provenance = read_provenance(path)
        except InputError:
            continue
        if model in (None, provenance.model):
            found[path] = provenance
    return found


def _provenance(path: Path, facts: Any) -> Provenance:
    try:
        return Provenance.model_validate(facts)
    except ValidationError as error:
        raise InputError(
            f"{path} does not say which model its weights are for; import the official .pth file with: "
            "challenger-bench weights import PATH"
        ) from error
