"""An unfinished training run of a network, in memory and on disk."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import Tensor, nn

from benchmark.errors import InputError
from benchmark.weights.tensors import FACTS, read_tensors, write_tensors

Network = TypeVar("Network", bound=nn.Module)


@dataclass(slots=True)
class TrainingRun(Generic[Network]):
    """A run after ``step`` steps: its network and state of the optimiser, averaged weights by name, and log rows."""

    network: Network
    optimiser: torch.optim.AdamW
    average: dict[str, Tensor]
    log: list[dict[str, Any]]
    step: int = 0


def tensors_key(tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 of tensors with their names."""
    digest = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def write_run(run: TrainingRun[Any], path: Path, identity: str, *, entry: str = FACTS) -> None:
    """Write a run, whole or not at all, as a .safetensors file.

    Args:
        identity: Key of what it depends on.
        entry: Of the header: what the run says of itself.
    """
    tensors = {f"weights.{name}": tensor for name, tensor in run.network.state_dict().items()}
    tensors |= {f"average.{name}": tensor for name, tensor in run.average.items()}
    for index, moments in run.optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser.{index}.{name}": torch.as_tensor(value) for name, value in moments.items()}
    write_tensors(path, tensors, {"run": identity, "step": run.step, "log": run.log}, entry=entry)


def read_run(run: TrainingRun[Any], path: Path, identity: str, differs: str, *, entry: str = FACTS) -> None:
    """Bring a fresh run to where a file left it.

    Args:
        identity: Key of what the run depends on.
        differs: What may be different in a file of another run, for the message.
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
