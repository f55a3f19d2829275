"""Deterministic synthetic weights: every tensor of a state dict is a function of its name, its shape and a salt.

Two implementations of one architecture that agree on tensor names and shapes therefore get the same weights
without any weight file being shipped, and can be compared output by output.
"""

import hashlib
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray


def normal(name: str, shape: tuple[int, ...], salt: str) -> NDArray[Any]:
    """Standard normal float64 array that depends on nothing but its arguments."""
    key = int.from_bytes(hashlib.sha256(f"{salt}:{name}".encode()).digest()[:8], "little")
    return np.random.Generator(np.random.Philox(key=key)).standard_normal(shape)


def tensor_for(name: str, shape: tuple[int, ...], salt: str, std_rules: dict[str, float] | None = None) -> NDArray[Any]:
    """The synthetic value of state-dict entry `name` as float32 (int64 zero for num_batches_tracked).

    std_rules: regex (re.search on the name) -> std; the first match wins over the default scaling of tensors
    with two or more dimensions, 1/sqrt(prod(shape[1:])).
    """
    leaf = name.rsplit(".", 1)[-1]
    if leaf == "num_batches_tracked":
        return np.zeros(shape, np.int64)
    noise = normal(name, tuple(shape), salt)
    if leaf == "running_mean":
        value = 0.1 * noise
    elif leaf == "running_var":
        value = 1.0 + 0.1 * np.abs(noise)
    else:
        rule = next((std for pattern, std in (std_rules or {}).items() if re.search(pattern, name)), None)
        if rule is not None:
            value = rule * noise
        elif len(shape) >= 2:
            value = noise / np.sqrt(np.prod(shape[1:]))
        elif leaf == "weight":
            value = 1.0 + 0.1 * noise
        else:
            value = 0.02 * noise
    return value.astype(np.float32)
