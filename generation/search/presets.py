"""The settings that a search starts from: this project's, the paper's text, or the public reference code.

``near`` is this project's before it threatened, with the paper's nearness alone: the search of the frozen splits
mini-adv-1 and mini-adv-2. mini-adv-3 and mini-adv-4 are of ``default``, mini-adv-5 of ``effect``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from benchmark.errors import InputError
from generation.search.hyperparameters import HyperParameters, LaunchRule
from generation.search.threat_settings import CandidateProposal, EgoDriver

if TYPE_CHECKING:
    from generation.search.definition import PackagedPrior

Preset = Literal["default", "effect", "near", "paper", "reference"]
PRESETS: Final[tuple[Preset, ...]] = ("default", "effect", "near", "paper", "reference")
PRESSING_TRIES: Final = 3
"""Searches for one vehicle where the ego reacts: the one that presses it most is kept."""
PROPOSED_VEHICLES, PROPOSED_TRIES = 120, 6
"""Vehicles of a scene whose edits are looked at, and edits of one that are judged."""
SampleSource = Literal["fresh", "reference", "stored"]


def build_default_settings() -> HyperParameters:
    """The default: what was measured best (``docs/generation.md``, "What was measured")."""
    return HyperParameters(
        launch=LaunchRule.REACH,
        tries=1,
        ac_weight=0.0,
        lookahead_weight=0.06,
        threat_weight=10.0,
        closing_weight=2.0,
        careful_weight=3.0,
        side_weight=4.0,
        behind_weight=3.0,
        against_weight=2.0,
        hover_weight=2.0,
        area_weight=4.0,
        careful_survives=True,
    )


def build_further_settings(
    preset: Preset, settings: Mapping[str, Any] | None = None, changes: Sequence[str] = ()
) -> tuple[HyperParameters, ...]:
    """Settings of the further searches of a preset: of ``effect`` nearness, edits of timing, lanes and side.

    Threat and nearness find different failures; threat, the first search, is drawn again at the end. What is changed in
    the first search is changed in those that have the same value; arguments and errors as of `build_hyper_parameters`.
    """
    if preset != "effect":
        return ()
    own: dict[str, Any] = {"behaviour": True, "careful_survives": True}
    near = HyperParameters(
        launch=LaunchRule.REACH, lookahead_weight=0.06, against_weight=2.0, area_weight=4.0, tries=1, **own
    )
    near = replace(near, **{name: value for name, value in (settings or {}).items() if value is not None})
    proposed = [
        HyperParameters(
            proposal=proposal,
            candidate_limit=PROPOSED_VEHICLES,
            tries=PROPOSED_TRIES,
            solvable=near.solvable,
            **own,
        )
        for proposal in (CandidateProposal.RETIMED, CandidateProposal.REROUTED, CandidateProposal.SWERVED)
    ]
    first, names = build_hyper_parameters(preset), [change.partition("=")[0].strip() for change in changes]
    changed = tuple(
        hyper.changed([
            change
            for change, name in zip(changes, names, strict=True)
            if getattr(hyper, name) == getattr(first, name)
        ])
        for hyper in (near, *proposed)
    )  # fmt: skip
    return *changed, build_hyper_parameters(preset, settings, changes)


def build_hyper_parameters(
    preset: Preset = "default", settings: Mapping[str, Any] | None = None, changes: Sequence[str] = ()
) -> HyperParameters:
    """Settings of the search: the preset, settings by name, and changes by text, each over the last.

    Args:
        preset: ``default`` is this project's best, ``effect`` the first of several searches whose scenes a panel
            chooses (`build_further_settings`), ``near`` what it was before it threatened, ``paper`` the text,
            ``reference`` the public code (`generation.search.differences_from_paper` says where they cannot be
            followed).
        settings: Values of single settings; ``None`` leaves a setting as it is.
        changes: ``name=value`` (`HyperParameters.changed`).

    Returns:
        The settings.

    Raises:
        InputError: If a change names no setting, its value does not fit, or the preset needs the recorded ego.
    """
    match preset:
        case "default":
            start = build_default_settings()
        case "effect":
            start = replace(build_default_settings(), behaviour=True)
        case "near":
            start = HyperParameters()
        case "paper":
            start = HyperParameters.paper()
        case "reference":
            start = HyperParameters.reference()
    given = {name: value for name, value in (settings or {}).items() if value is not None}
    if given.get("ego", EgoDriver.RECORDED) is not EgoDriver.RECORDED:
        given.setdefault("tries", PRESSING_TRIES)
    hyper = replace(start, **given).changed(changes)
    if hyper.ego is not EgoDriver.RECORDED and preset not in ("default", "near"):
        raise InputError(
            f"preset {preset} needs the recorded ego, which never answers; leave --ego out or choose preset default"
        )
    return hyper


def build_trajectory_model(
    preset: Preset = "default",
    weights: Path | None = None,
    device: str = "cpu",
    *,
    calls: int | None = None,
    dropout: bool = False,
    samples: SampleSource | None = None,
) -> "PackagedPrior":
    """The trajectory model that proposes candidates.

    With the presets ``paper`` and ``reference`` it is not told how the vehicle moves, samples by the reference's 100
    steps, and nothing that it draws is drawn again; with ``reference`` dropout is on.

    Args:
        preset: As in `build_hyper_parameters`.
        weights: Of another model than the packaged one.
        device: Where it runs.
        calls: Most network calls of a mutation; the reference has one a noise level.
        dropout: Sample with dropout on, as the reference code does by an omission.
        samples: Where new candidates come from (`generation.diffusion.prior.CandidateSource`), if not where the preset
            says.

    Returns:
        Factory of the model for each process.
    """
    # Settings are checked before anything runs, and torch is slow to import.
    from generation.diffusion.prior import CandidateSource, SamplerSettings
    from generation.search.definition import PackagedPrior

    ours = preset in ("default", "effect", "near")
    source = CandidateSource(samples or ("fresh" if ours else "reference"))
    dropout = dropout or preset == "reference"
    sampler = SamplerSettings(samples=source, conditioned=ours, mutation_steps=calls, drivable=ours, dropout=dropout)
    return PackagedPrior(weights, device, sampler)
