"""`challenger-bench verify model`: networks of ours against numbers of their official code, with synthetic weights."""

from functools import partial
from pathlib import Path
from typing import cast

from adapters.models import published_models, resolve, verified_models
from benchmark.errors import InputError
from benchmark.verification.checks import Check


def verify_model(name: str, golden: Path, device: str = "cpu", *, noise: bool = False) -> list[Check]:
    """Fill a network by the names of its tensors, run the golden frames in order, and compare what is stored.

    ``golden`` is a set's folder, or a model's with several. The first check stands alone if names or shapes differ;
    with ``noise`` our network runs twice more, to know how far its own rounding moves each quantity.
    """
    known = verified_models()
    if name not in known:
        raise InputError(f"model {name!r} cannot be verified; choose one of {', '.join(known)}")
    verify = partial(resolve(known[name]).verify, published_models()[name], golden, device)
    if not noise:
        return cast("list[Check]", verify())
    # It imports torch, which a refusal does not wait for.
    from adapters.extensions.golden_sets.parity_set import add_floating_point_noise

    return add_floating_point_noise(verify)
