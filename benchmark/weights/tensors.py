"""Tensors with facts about them as JSON in the header of one safetensors file; training runs stored likewise."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, write_bytes
from benchmark.untrusted.arrays import require_sound_header
from benchmark.untrusted.files import to_one_line
from benchmark.untrusted.text_files import parse_json

FACTS: Final = "challenger-bench"
"""Name of the header's entry, if a kind of file has none of its own."""
_BROKEN: Final = (OSError, ValueError, safetensors.SafetensorError)


def write_tensors(path: Path, tensors: Mapping[str, Tensor], facts: Any, *, entry: str = FACTS) -> None:
    """Write tensors and facts, whole or not at all; the same content gives the same bytes.

    Facts are one entry of the header, because the order of several is not fixed; its name tells kinds of files apart.
    """
    # Copied one by one: safetensors refuses tensors that share memory, as slices of one storage do.
    contiguous = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in tensors.items()
    }
    write_bytes(path, safetensors.torch.save(contiguous, {entry: canonical_json(facts)}))


def read_tensors(
    path: Path, *, entry: str = FACTS, what: str = "weights from ", instead: str = "fetch or make the file again"
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors by name and facts, empty where there is no such entry, of `write_tensors` or any other safetensors file.

    ``what`` (what it would hold) and ``instead`` (what to do if it is broken) are for the message.
    """
    try:
        require_sound_header(path)
        with safetensors.safe_open(path, framework="pt") as stream:
            tensors = {name: stream.get_tensor(name) for name in sorted(stream.keys())}
            return tensors, _facts(stream, entry)
    except _BROKEN as error:
        raise InputError(f"cannot read {what}{path} ({to_one_line(error)}); {instead}") from error


def read_header(path: Path, *, instead: str) -> tuple[dict[str, tuple[int, ...]], dict[str, Any]]:
    """Shapes by name and facts of a file of weights; the tensors are not read."""
    try:
        require_sound_header(path)
        with safetensors.safe_open(path, framework="pt") as stream:
            shapes = {name: tuple(stream.get_slice(name).get_shape()) for name in list(stream.keys())}
            return shapes, _facts(stream, FACTS)
    except _BROKEN as error:
        raise InputError(f"cannot read weights from {path} ({to_one_line(error)}); {instead}") from error


def _facts(stream: Any, entry: str) -> dict[str, Any]:
    facts = parse_json((stream.metadata() or {}).get(entry, "null").encode())
    return facts if isinstance(facts, dict) else {}


Network = TypeVar("Network", bound=nn.Module)


@dataclass(slots=True)
class TrainingRun(Generic[Network]):
    """A run after ``step`` steps: its network and state of the optimiser, averaged weights by name, and log rows."""

    network: Network
    optimiser: torch.optim.AdamW
    average: dict[str, Tensor]
    log: list[dict[str, Any]]
    step: int = 0


def hash_tensors(tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 of tensors with their names."""
    digest = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def write_run(run: TrainingRun[Any], path: Path, identity: str, *, entry: str = FACTS) -> None:
    """Write a run, whole or not at all, as a .safetensors file; ``identity`` is the key of what it depends on.

    ``entry`` of the header has what the run says of itself.
    """
    tensors = {f"weights.{name}": tensor for name, tensor in run.network.state_dict().items()}
    tensors |= {f"average.{name}": tensor for name, tensor in run.average.items()}
    for index, moments in run.optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser.{index}.{name}": torch.as_tensor(value) for name, value in moments.items()}
    write_tensors(path, tensors, {"run": identity, "step": run.step, "log": run.log}, entry=entry)


def read_run(run: TrainingRun[Any], path: Path, identity: str, differs: str, *, entry: str = FACTS) -> None:
    """Bring a fresh run to where a file left it; ``identity`` is the key of what the run depends on.

    ``differs`` is what may be different in a file of another run, for the message.
    """
    tensors, facts = read_tensors(path, entry=entry, what="", instead="remove it to train from the beginning")
    if not facts:
        raise InputError(f"cannot read {path} ({entry!r}); remove it to train from the beginning")
    if facts["run"] != identity:
        raise InputError(f"{path} belongs to a training run with other {differs}; remove it or choose another --out")
    run.network.load_state_dict({name[8:]: value for name, value in tensors.items() if name.startswith("weights.")})
    with torch.no_grad():
        for name, value in run.average.items():
            value.copy_(tensors[f"average.{name}"])
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimiser."):
            _, index, moment = name.split(".", 2)
            moments.setdefault(int(index), {})[moment] = value
    state = run.optimiser.state_dict()
    run.optimiser.load_state_dict({"state": moments, "param_groups": state["param_groups"]})
    run.step, run.log = int(facts["step"]), list(facts["log"])
