"""Which model really runs, and whether it has weights; no file is opened, and torch not imported, where none is."""

from collections.abc import Collection
from pathlib import Path

from adapters.models import MODELS, miniatures
from benchmark.errors import InputError
from benchmark.machine.workspace import is_embedded_name, weights_root
from benchmark.weights.catalogue import CHECKPOINTS, PublishedWeights


def stand_in(name: str, checkpoint: Path | None, data_name: str) -> str:
    """Name of the model that really runs: a miniature on embedded data if the full model has no weights."""
    if checkpoint is not None or not is_embedded_name(data_name):
        return name
    small = miniature_of(name)
    return name if small is None or has_weights(name) else small


def miniature_of(name: str) -> str | None:
    """The miniature of a full model whose weights are in this installation, or ``None``."""
    full = MODELS[name].name if name in MODELS else name
    candidates = (
        model for model in miniatures().values() if full in model.small.stands_for and model.packaged.is_file()
    )
    return next((model.name for model in candidates), None)


def find_recorded_name(name: str, ran: Collection[str]) -> str | None:
    """Name under which records have a planner: its own, its full one, or the miniature's that ran in its place.

    ``ran`` are the planners that have records; ``None`` where it is none of them.
    """
    own = MODELS[name].name if name in MODELS else name
    return next((known for known in (name, own, miniature_of(own)) if known is not None and known in ran), None)


def has_weights(name: str) -> bool:
    """Whether a full model has weights that were imported."""
    model, folder = MODELS[name], weights_root()
    if not any(folder.glob("*.safetensors")):
        return False
    # The files name their model.
    from adapters.checkpoints.cache import cached_weights

    return bool(cached_weights(folder, model.weights or model.name))


def require_weights(name: str, checkpoint: Path | None) -> None:
    """Refuse a network that has no weights, before anything is made ready for it; say what to get and where."""
    model = MODELS.get(name)
    if checkpoint is not None and not checkpoint.exists():
        raise InputError(f"there is no checkpoint {checkpoint}")
    if model is None or model.network is None or checkpoint is not None:
        return
    if model.miniature is None and not has_weights(name):
        raise missing_weights_error(model.weights or model.name)


def missing_weights_error(model: str) -> InputError:
    """Error that says that a full model has no weights."""
    small = miniature_of(model)
    instead = "" if small is None else f"; or try its packaged miniature: --model {small}"
    return InputError(f"there are no weights for {model}; {describe_how_to_get(model)}{instead}")


def official_weights(model: str) -> PublishedWeights | None:
    """The official file of a model, if one is known."""
    return next((entry for entry in CHECKPOINTS if entry.name == model), None)


def describe_how_to_get(model: str) -> str:
    """Sentence that says where the weights of a model are had."""
    official = official_weights(model)
    if official is None:
        return "give a file with --checkpoint"
    files = " and ".join(f"{file.name} from {file.page}" for file in official.files)
    return f"get {files} (or run: challenger-bench weights fetch {model}), then run: {official.how_to_import}"
