"""Implementation of ``verify``: comparisons with golden numbers in every package that computes."""

from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.errors import InputError, did_you_mean
from benchmark.machine.extension import import_from_extension, list_offers

if TYPE_CHECKING:
    from benchmark.verification.checks import Check
    from benchmark.verification.golden_sets import GoldenSet


def verify(what: str, golden: Path | None = None, model: str | None = None, *, noise: bool = False) -> "list[Check]":
    """Compare numerics with golden numbers (docs/extensions/golden_sets.md).

    Args:
        what: ``physics``, ``scoring``, ``denoiser``, ``protocols``, ``pdm``, ``drivers``, ``severity``, ``realism``,
            ``fault``, ``ability``, ``neuroncap``, ``alpasim``, ``infos``, ``hub``, ``import-123d``, ``results``
            or ``model``.
        golden: Folder of golden numbers; the built-in set by default, which ``infos``, ``hub``, ``import-123d`` and
            ``model`` lack. Of a name with several sets, the folder of all of them or of one.
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
    return [check for golden_set, folder in _find_sets(what, golden) for check in golden_set.verify(folder)]


def _find_sets(what: str, golden: Path | None) -> "list[tuple[GoldenSet, Path | None]]":
    """The set of a name, and its parts ``NAME FOLDER`` in folders below ``golden``, or the one that it is."""
    known = list_offers("golden set")
    parts = {name.partition(" ")[2]: name for name in known if name.startswith(f"{what} ")}
    if what not in known and not parts:
        others = ", ".join(dict.fromkeys(name.partition(" ")[0] for name in known if name != "model"))
        raise InputError(f"cannot verify {what!r}; golden numbers exist for {others} and model")
    places: dict[str, Path | None] = {what: golden} if what in known else {}
    alone = None if golden is None else parts.get(_read_set_name(golden))
    if alone is not None:
        places = {alone: golden}
    elif golden is None:
        places |= dict.fromkeys(parts.values())
    else:
        places |= {name: golden / folder for folder, name in parts.items() if (golden / folder).is_dir()}
    if not places:
        raise InputError(f"{golden} holds no golden set of {what} ({', '.join(parts)}); give the folder of them or one")
    sets = [(import_from_extension("golden set", name), folder) for name, folder in places.items()]
    # Without a folder, those that are in the package; if none is, the first says so.
    return [(own, of) for own, of in sets if of is not None or own.built_in or own.made_here] or sets[:1]


def _read_set_name(folder: Path) -> str:
    """Name of a set by its manifest, or else by its folder."""
    from benchmark.untrusted.text_files import read_json

    manifest = folder / "manifest.json"
    stored = read_json(manifest) if manifest.is_file() else None
    return str(stored.get("set", "")) if isinstance(stored, dict) else folder.resolve().name


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
