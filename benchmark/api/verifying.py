"""What stands behind ``verify``: comparisons with golden numbers, wherever the numerics are."""

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast

from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from benchmark.verification.checks import Check

_VERIFIED: Final = {
    "physics": "generation.extensions.golden_sets.physics",
    "scoring": "generation.extensions.golden_sets.scoring",
    "denoiser": "generation.extensions.golden_sets.denoiser",
    "protocols": "benchmark.extensions.golden_sets.protocols",
    "pdm": "benchmark.extensions.golden_sets.pdm",
    "results": "adapters.extensions.golden_sets.result_files",
    "drivers": "benchmark.extensions.golden_sets.drivers",
    "severity": "benchmark.extensions.golden_sets.severity",
    "realism": "benchmark.extensions.golden_sets.realism",
    "infos": "benchmark.extensions.infos.verification",
    "neuroncap": "benchmark.extensions.neuroncap.verification",
}
"""What `verify` compares, and where its ``verify_NAME`` is: imported when it is asked for, since some need torch."""


def verify(what: str, golden: Path | None = None, model: str | None = None, *, noise: bool = False) -> "list[Check]":
    """Compare numerics with golden numbers (docs/extensions/golden_sets.md).

    Args:
        what: ``physics``, ``scoring``, ``denoiser``, ``protocols``, ``pdm``, ``drivers``, ``severity``, ``realism``,
            ``neuroncap``, ``infos``, ``results`` or ``model``.
        golden: Folder of golden numbers; the built-in set by default, which ``infos`` and ``model`` do not have.
        model: With ``model``: which one.
        noise: With ``model``: also how far our own rounding moves each quantity, for which our network runs twice more.

    Returns:
        One check for each quantity.

    Raises:
        InputError: If there is nothing of that name to compare, or the golden numbers cannot be used.
    """
    if what == "model":
        return _verify_model(model, golden, noise=noise)
    if noise:
        raise InputError("--noise belongs to verify model; leave it out")
    if model is not None:
        raise InputError("--model belongs to verify model; leave it out")
    if what not in _VERIFIED:
        raise InputError(f"cannot verify {what!r}; what has golden numbers is {', '.join(_VERIFIED)} and model")
    verified = getattr(importlib.import_module(_VERIFIED[what]), f"verify_{what}")
    return cast("list[Check]", verified(golden))


def _verify_model(model: str | None, golden: Path | None, *, noise: bool) -> "list[Check]":
    from adapters.extensions.golden_sets.models import verified_models, verify_model

    known = (*verified_models(), "magicdrive")
    if model not in known:
        missing = "verify model needs --model" if model is None else f"no model {model!r} can be verified"
        raise InputError(f"{missing}; {did_you_mean(model or '', known)}known are {', '.join(known)}")
    if golden is None:
        raise InputError("verify model needs --golden, a directory of numbers of the official code; none is built in")
    if model != "magicdrive":
        return verify_model(model, golden, noise=noise)
    if noise:
        raise InputError("--noise is for driving models; leave it out for magicdrive")
    from generation.extensions.golden_sets.magicdrive import verify_magicdrive

    return verify_magicdrive(golden)
