"""Synthetic weights: every tensor of a network is a function of its name, its shape and a salt.

Two implementations of one architecture that agree on names and shapes get the same weights without any weights file,
and can be compared output by output. All golden sets of networks are filled like this (`challenger-bench verify`).
"""

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

_Value = TypeVar("_Value")


def _expression(text: str) -> str:
    try:
        re.compile(text)
    except re.error as error:
        raise ValueError(f"{text!r} is not a regular expression: {error}") from error
    return text


Expression = Annotated[str, AfterValidator(_expression)]
"""Searched for in the names of tensors; where several are found, the first counts."""


class WeightsRecipe(BaseModel):
    """How the weights of a golden set are made; its ``manifest.json`` may hold more than this.

    ``salt`` tells one set from another, ``std_rules`` are those of `make_synthetic_tensor`, and ``shift_rules`` add a
    number or a list to synthetic entries. ``constant_overrides`` are one number throughout. ``kept_buffers`` keep their
    real values, given by name; names alone where the values lie in another file.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    salt: str
    std_rules: dict[Expression, float] = Field(default_factory=dict)
    constant_overrides: dict[str, float] = Field(default_factory=dict)
    shift_rules: dict[Expression, float | list[float]] = Field(default_factory=dict)
    kept_buffers: dict[str, Any] | list[str] = Field(default_factory=dict)

    def state(
        self, shapes: Mapping[str, Sequence[int]], kept: Mapping[str, ArrayLike] | None = None
    ) -> dict[str, NDArray[Any]]:
        """All entries of a state dict, by name: kept, else constant, else synthetic and then shifted.

        ``kept`` has values of the kept buffers, where the recipe has their names only.
        """
        inline = self.kept_buffers if isinstance(self.kept_buffers, dict) else {}
        buffers = {**inline, **(kept or {})}
        state: dict[str, NDArray[Any]] = {}
        for name, shape in shapes.items():
            if name in buffers:
                value = np.asarray(buffers[name]).reshape(tuple(shape))
                state[name] = value.astype(np.float32) if value.dtype.kind == "f" else value
            elif name in self.constant_overrides:
                state[name] = np.full(tuple(shape), self.constant_overrides[name], np.float32)
            else:
                value = make_synthetic_tensor(name, shape, self.salt, self.std_rules)
                shift = _find_matching(self.shift_rules, name)
                state[name] = value if shift is None else value + np.asarray(shift, np.float32)
        return state


def read_shapes(stored: Any) -> dict[str, tuple[int, ...]]:
    """Shapes of a network's tensors by name, in the order of a ``keys.json``.

    It holds ``{name: {"shape": [...]}}``, or ``[[name, shape, type], ...]``.
    """
    pairs = [(name, entry["shape"]) for name, entry in stored.items()] if isinstance(stored, dict) else stored
    return {str(name): tuple(int(length) for length in shape) for name, shape, *_ in pairs}


def draw_seeded_normal(name: str, shape: Sequence[int], salt: str) -> NDArray[np.float64]:
    """Standard normal numbers that depend on nothing but the arguments.

    They are of a Philox stream whose key is the first eight bytes, little-endian, of SHA-256 of ``salt:name``.
    """
    digest = hashlib.sha256(f"{salt}:{name}".encode()).digest()
    stream = np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:8], "little")))
    return np.asarray(stream.standard_normal(tuple(shape)))


def make_synthetic_tensor(
    name: str, shape: Sequence[int], salt: str, std_rules: Mapping[str, float] | None = None
) -> NDArray[Any]:
    """float32 value of a state dict's entry, by the last part of its name; int64 zero for ``num_batches_tracked``.

    With z from `draw_seeded_normal`, running means are 0.1 z and running variances 1 + 0.1 |z|. Else the first of
    ``std_rules`` whose expression is found in the name gives the standard deviation. Without one, tensors of two or
    more axes are z / sqrt(product of all but the first), vectors named ``weight`` are 1 + 0.1 z and all others 0.02 z.
    """
    kind = name.rpartition(".")[2]
    if kind == "num_batches_tracked":
        return np.zeros(tuple(shape), np.int64)
    noise = draw_seeded_normal(name, shape, salt)
    if kind == "running_mean":
        value = 0.1 * noise
    elif kind == "running_var":
        value = 1.0 + 0.1 * np.abs(noise)
    elif (spread := _find_matching(std_rules or {}, name)) is not None:
        value = spread * noise
    elif len(shape) >= 2:
        value = noise / np.sqrt(math.prod(shape[1:]))
    elif kind == "weight":
        value = 1.0 + 0.1 * noise
    else:
        value = 0.02 * noise
    return value.astype(np.float32)


def _find_matching(rules: Mapping[str, _Value], name: str) -> _Value | None:
    return next((value for expression, value in rules.items() if re.search(expression, name)), None)
