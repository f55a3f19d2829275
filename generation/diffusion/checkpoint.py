"""Weights on disk: safetensors of ours, or the published checkpoint, which is a bare state dict."""

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.untrusted.files import one_line
from benchmark.weights.foreign import read_checkpoint
from benchmark.weights.tensors import read_tensors, write_tensors
from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser

PACKAGED_WEIGHTS: Final = Path(__file__).parent / "weights" / "denoiser.safetensors"
_LARGEST_SIZE: Final = 1 << 16
_MOST_LAYERS: Final = 256


def save_denoiser(path: Path, denoiser: TrajectoryDenoiser, facts: dict[str, Any]) -> None:
    """Write a denoiser that `load_denoiser` gives back.

    ``facts`` are remembered with it, for example seed and steps.
    """
    write_tensors(path, denoiser.state_dict(), {**facts, "denoiser": asdict(denoiser.config)})


def load_denoiser(path: Path) -> TrajectoryDenoiser:
    """A denoiser in evaluation mode.

    Args:
        path: ``.safetensors`` of ours, or of the published parameters; anything else is read as a state dict of the
            published checkpoint (`benchmark.weights.foreign`).

    Returns:
        The network. (The reference samples with dropout on, by an omission; here it is off.)

    Raises:
        InputError: If the file is absent or broken, would run code, or does not fit the architecture.
    """
    if not path.is_file():
        raise InputError(f"no weights at {path}; pass a .safetensors file, or the published ig360_adv.ckpt")
    tensors, facts = read_tensors(path) if path.suffix == ".safetensors" else (read_checkpoint(path).tensors, {})
    config = _config(path, facts.get("denoiser", {}))
    _require_same_shapes(path, config, tensors)
    denoiser = TrajectoryDenoiser(config)
    denoiser.load_state_dict({name: tensor.to(torch.float32) for name, tensor in tensors.items()}, strict=True)
    if not all(bool(torch.isfinite(tensor).all()) for tensor in denoiser.state_dict().values()):
        raise InputError(f"the weights in {path} hold NaN or infinity; fetch or make the file again")
    return denoiser.eval()


def _config(path: Path, said: Any) -> DenoiserConfig:
    """Configuration of the network of a file, if there can be such a network."""
    kinds = {field.name: type(field.default) for field in fields(DenoiserConfig)}
    wrong = f"{path} says of its network what no trajectory denoiser is"
    if not isinstance(said, dict) or not set(said) <= set(kinds):
        raise InputError(f"{wrong}; fetch or make the file again")
    for name, value in said.items():
        known = type(value) is kinds[name] or (kinds[name] is float and type(value) is int)
        if not known or not 0 <= abs(value) <= _LARGEST_SIZE:
            raise InputError(f"{wrong} ({name} {str(value)[:40]!r}); fetch or make the file again")
    if not 0 <= said.get("dropout", 0) < 1 or said.get("layers", 0) > _MOST_LAYERS:
        raise InputError(f"{wrong} (dropout or layers); fetch or make the file again")
    return DenoiserConfig(**said)


def _require_same_shapes(path: Path, config: DenoiserConfig, tensors: Mapping[str, Tensor]) -> None:
    """Compare names and shapes with a network that has no memory yet: a file may claim one of any size."""
    try:
        with torch.device("meta"):
            expected = TrajectoryDenoiser(config).state_dict()
    except (ArithmeticError, RuntimeError, ValueError) as error:
        raise InputError(f"{path} says of its network what no trajectory denoiser is ({error}); get another") from error
    kinds = (
        ([name for name in expected if name not in tensors], "missing"),
        ([name for name in tensors if name not in expected], "too many"),
        ([n for n in expected if n in tensors and tensors[n].shape != expected[n].shape], "of another shape"),
        ([name for name, tensor in tensors.items() if tensor.is_complex()], "no real numbers"),
    )
    differences = "; ".join(f"{len(names)} {what} (first: {one_line(names[0])})" for names, what in kinds if names)
    if differences:
        raise InputError(
            f"the weights in {path} do not fit the trajectory denoiser: of its tensors, {differences}; get the "
            "published ig360_adv.ckpt, or a .safetensors file of train denoiser"
        )
