"""Tensors with facts about them: one safetensors file, whose header holds the facts as JSON."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, write_bytes
from benchmark.untrusted.files import one_line
from benchmark.untrusted.json_text import parse_json
from benchmark.untrusted.tensor_headers import require_sound_header

FACTS: Final = "challenger-bench"
"""Name of the header's entry, if a kind of file has none of its own."""
_BROKEN: Final = (OSError, ValueError, safetensors.SafetensorError)


def write_tensors(path: Path, tensors: Mapping[str, Tensor], facts: Any, *, entry: str = FACTS) -> None:
    """Write tensors and facts, whole or not at all; the same content gives the same bytes.

    Args:
        facts: JSON values; one entry of the header, because the order of several is not fixed.
        entry: Its name, which tells kinds of files apart.
    """
    # Each on its own: safetensors refuses tensors that share memory, as slices of one storage do.
    held = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in tensors.items()
    }
    write_bytes(path, safetensors.torch.save(held, {entry: canonical_json(facts)}))


def read_tensors(
    path: Path, *, entry: str = FACTS, what: str = "weights from ", instead: str = "fetch or make the file again"
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors by name and facts that `write_tensors` wrote, or those of any other safetensors file.

    Facts are empty where there is no such entry.

    Args:
        what: What the file would hold, for the message.
        instead: What to do if it is broken, for the message.
    """
    try:
        require_sound_header(path)
        with safetensors.safe_open(path, framework="pt") as stream:
            tensors = {name: stream.get_tensor(name) for name in sorted(stream.keys())}
            return tensors, _facts(stream, entry)
    except _BROKEN as error:
        raise InputError(f"cannot read {what}{path} ({one_line(error)}); {instead}") from error


def read_header(path: Path, *, instead: str) -> tuple[dict[str, tuple[int, ...]], dict[str, Any]]:
    """Shapes by name and facts of a file of weights; the tensors are not read."""
    try:
        require_sound_header(path)
        with safetensors.safe_open(path, framework="pt") as stream:
            shapes = {name: tuple(stream.get_slice(name).get_shape()) for name in list(stream.keys())}
            return shapes, _facts(stream, FACTS)
    except _BROKEN as error:
        raise InputError(f"cannot read weights from {path} ({one_line(error)}); {instead}") from error


def _facts(stream: Any, entry: str) -> dict[str, Any]:
    facts = parse_json((stream.metadata() or {}).get(entry, "null").encode())
    return facts if isinstance(facts, dict) else {}
