"""Implementation of ``verify``: comparisons with golden numbers in every package that computes."""

from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.errors import InputError, did_you_mean
from benchmark.machine.extension import import_from_extension, list_offers

if TYPE_CHECKING:
    from benchmark.verification.checks import Check


def verify(what: str, golden: Path | None = None, model: str | None = None, *, noise: bool = False) -> "list[Check]":
    """Compare numerics with golden numbers (docs/extensions/golden_sets.md).

    Args:
        what: ``physics``, ``scoring``, ``denoiser``, ``protocols``, ``pdm``, ``drivers``, ``severity``, ``realism``,
            ``fault``, ``ability``, ``neuroncap``, ``infos``, ``hub``, ``results`` or ``model``.
        golden: Folder of golden numbers; the built-in set by default, which ``infos``, ``hub``, ``model`` lack.
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
        raise InputError("--noise applies only to verify model; leave it out")
    if model is not None:
        raise InputError("--model applies only to verify model; leave it out")
    known = list_offers("golden set")
    if what not in known:
        others = ", ".join(name for name in known if name != "model")
        raise InputError(f"cannot verify {what!r}; golden numbers exist for {others} and model")
    checks: list[Check] = import_from_extension("golden set", what).verify(golden)
    return checks


def _verify_model(model: str | None, golden: Path | None, *, noise: bool) -> "list[Check]":
    from adapters.models import verified_models

    renderers = list_offers("golden set of a renderer")
    known = (*verified_models(), *renderers)
    if model not in known:
        missing = "verify model needs --model" if model is None else f"no model {model!r} can be verified"
        raise InputError(f"{missing}; {did_you_mean(model or '', known)}known are {', '.join(known)}")
    if golden is None:
        raise InputError("verify model needs --golden, a directory of outputs of the official code; none are built in")
    checks: list[Check]
    if model not in renderers:
        checks = import_from_extension("golden set", "model")(model, golden, noise=noise)
        return checks
    if noise:
        raise InputError(f"--noise applies only to driving models; leave it out for {model}")
    checks = import_from_extension("golden set of a renderer", model)(golden)
    return checks
