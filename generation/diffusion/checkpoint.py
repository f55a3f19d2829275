"""Weights on disk: safetensors of ours, or the published checkpoint, which is a bare state dict."""

import pickle
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.weights.tensors import read_tensors, write_tensors
from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser

PACKAGED_WEIGHTS: Final = Path(__file__).parent / "weights" / "denoiser.safetensors"


def save_denoiser(path: Path, denoiser: TrajectoryDenoiser, facts: dict[str, Any]) -> None:
    """Write a denoiser that `load_denoiser` gives back.

    Args:
        path: A .safetensors file.
        denoiser: The network.
        facts: What else to remember, for example seed and steps.
    """
    write_tensors(path, denoiser.state_dict(), {**facts, "denoiser": asdict(denoiser.config)})


def load_denoiser(path: Path) -> TrajectoryDenoiser:
    """A denoiser in evaluation mode.

    Args:
        path: ``.safetensors`` of ours, or of the published parameters; anything else is read as a bare state dict of
            the published checkpoint, by PyTorch's weights-only unpickler.

    Returns:
        The network. (The reference samples with dropout on, by an omission; here it is off.)

    Raises:
        InputError: If the file is absent or broken, would run code, or does not fit the architecture.
    """
    if not path.is_file():
        raise InputError(f"no weights at {path}; pass a .safetensors file, or the published ig360_adv.ckpt")
    tensors, facts = read_tensors(path) if path.suffix == ".safetensors" else (_read_state_dict(path), {})
    try:
        denoiser = TrajectoryDenoiser(DenoiserConfig(**facts.get("denoiser", {})))
        denoiser.load_state_dict(tensors, strict=True)
    except (RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[-1].strip()
        raise InputError(f"the weights in {path} do not fit the trajectory denoiser: {reason}") from error
    if not all(bool(torch.isfinite(tensor).all()) for tensor in denoiser.state_dict().values()):
        raise InputError(f"the weights in {path} hold NaN or infinity; fetch or make the file again")
    return denoiser.eval()


def _read_state_dict(path: Path) -> dict[str, Tensor]:
    try:
        # A foreign pickle protocol is worth a warning to PyTorch; here it either yields tensors or is refused below.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            loaded = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, OSError, ValueError) as error:
        # What PyTorch says goes on with advice to load it unsafely, so only the kind of error is passed on.
        raise InputError(
            f"{path} is not a plain state dict ({type(error).__name__}: empty, damaged, or more than tensors); a "
            "checkpoint may hold tensors only, nothing that runs code"
        ) from error
    if not isinstance(loaded, dict) or not all(isinstance(tensor, Tensor) for tensor in loaded.values()):
        raise InputError(f"{path} is not a bare state dict of tensors; the published ig360_adv.ckpt is one")
    return {str(name): tensor.to(torch.float32) for name, tensor in loaded.items()}
