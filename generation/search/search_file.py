"""``search.json`` beside a build's reports: what decided its attempts, so that any of them can be made again."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, read_json
from generation.diffusion.prior import SamplerSettings
from generation.nuscenes_writer.plan import STATE_FOLDER
from generation.search.adversary import ALGORITHM_VERSION
from generation.search.attempts import PackagedPrior, PriorFactory, Search
from generation.search.hyperparameters import CollisionReading, HyperParameters

SEARCH_FILE: Final = "search.json"


def search_file(search: Search) -> bytes:
    """Content of ``search.json``.

    Args:
        search: What decides the attempts of a build.

    Returns:
        JSON.
    """
    said = {
        "algorithm": ALGORITHM_VERSION,
        "source": search.fingerprint,
        "seed": search.seed,
        "prior": search.prior_fingerprint,
        "sampler": asdict(search.prior.sampler) if isinstance(search.prior, PackagedPrior) else None,
        "hyper": asdict(search.hyper),
        "hyper_fingerprint": search.hyper.fingerprint,
    }
    return (canonical_json(said, indent=1) + "\n").encode()


def read_search(root: Path, prior: PriorFactory | None = None) -> Search:
    """The search that a build made.

    Args:
        root: Root of the build.
        prior: Makes the diffusion model that the build had; by default the package's, asked as the build asked.

    Returns:
        The search; attempts are found by it where the build kept them.

    Raises:
        InputError: If the root does not say, or the build had another version of the search or another model.
    """
    path = root / SEARCH_FILE
    if not path.is_file():
        raise InputError(
            f"{root} has no {SEARCH_FILE}, so the search cannot be made again; run the same challenger-bench generate "
            "again if it was generated here (finished work is kept)"
        )
    said = read_json(path)
    try:
        hyper, sampler = _hyper_parameters(said), _sampler(said)
        source, seed, expected = str(said["source"]), int(said["seed"]), said["prior"]
    except (KeyError, TypeError, ValueError, InputError) as error:
        # Names or values that this version does not have.
        raise InputError(
            f"{path} is damaged or of another version of the search than this one ({ALGORITHM_VERSION}); run the same "
            "challenger-bench generate again"
        ) from error
    prior = prior or PackagedPrior(sampler=sampler)
    fingerprint = prior().fingerprint
    if fingerprint != expected:
        raise InputError(
            f"{root} was generated with other weights of the trajectory model than the package's, or on another kind "
            "of device, and its search cannot be made again here"
        )
    return Search(
        fingerprint=source,
        hyper=hyper,
        seed=seed,
        prior=prior,
        prior_fingerprint=fingerprint,
        state=root / STATE_FOLDER,
    )


def _hyper_parameters(said: Any) -> HyperParameters:
    """The settings, if they are exactly those that were written."""
    values = said["hyper"]
    hyper = HyperParameters(**{**values, "collision_reading": CollisionReading(values["collision_reading"])})
    if said["algorithm"] != ALGORITHM_VERSION or said["hyper_fingerprint"] != hyper.fingerprint:
        raise ValueError("another search")
    return hyper


def _sampler(said: Any) -> SamplerSettings:
    return SamplerSettings() if said["sampler"] is None else SamplerSettings(**said["sampler"])
