"""Every planner, what it sees, and what it needs that may not be here; and which of ours a record's planner is."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Literal

from adapters.checkpoints.cache import cached_weights, weights_folder
from adapters.models import MODELS, Model, baselines
from adapters.planners.names import installed_planners
from adapters.registry import planner_factory
from benchmark.records.run_schema import PlannerFacts
from benchmark.report.cells import MINIATURE_MARK, MINIATURE_WORDS, TableCell
from benchmark.report.table import Table, build_table
from benchmark.report.terminal import wrap_text
from benchmark.weights.catalogue import PublishedWeights, find_checkpoint

Weights = Literal["none needed", "packaged", "imported", "missing", "its own"]
_NETWORK_SEES: Final = "six images"
_PACKAGED_ALWAYS: Final = ("ego-status",)
"""Baselines that have learned something; it comes with this package."""


@dataclass(frozen=True, slots=True)
class PlannerListing:
    """One planner; `comes_from` is the published weights' name, or the package of an installed planner."""

    name: str
    sees: str
    weights: Weights
    gpu: str
    extra: str = ""
    here: bool = True
    miniature: bool = False
    also: tuple[str, ...] = ()
    comes_from: str = ""

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "also": list(self.also)}


def known_planners(
    cache: Path | None = None, installed: Mapping[str, EntryPoint] | None = None
) -> tuple[PlannerListing, ...]:
    """Every planner that has a name.

    Args:
        cache: Folder of imported weights; the user's by default.
        installed: Planners of installed packages; those that there are by default.

    Returns:
        Those of this package in the order of the table, then those of others.
    """
    folder, packages = cache or weights_folder(), installed_planners() if installed is None else installed
    built_in = [_list_built_in(model, folder) for name, model in MODELS.items() if name == model.name]
    return (
        *built_in,
        *(PlannerListing(name, "?", "its own", "?", comes_from=point.value) for name, point in packages.items()),
    )


def find_own_planner(planner: PlannerFacts) -> PlannerFacts | None:
    """This program's planner that a record describes: the one with the same code, else the one with the same name.

    Networks are looked at only if they are named and their weights come with this package.
    """
    model = MODELS.get(planner.name)
    called = None
    if model is not None and (model.network is None or model.packaged.is_file()):
        called = _facts(planner.name)
    if planner.code_sha256 is None or (called is not None and called.code_sha256 == planner.code_sha256):
        return called
    same_code = (facts for facts in map(_facts, baselines()) if facts.code_sha256 == planner.code_sha256)
    return next(same_code, called)


def planners_text(planners: tuple[PlannerListing, ...], width: int | None = None) -> str:
    """The planners as a table, and how to get what is missing."""
    missing = dict.fromkeys(planner.comes_from for planner in planners if planner.weights == "missing")
    lines = [planners_table(planners).plain(width=width)]
    if missing:
        lines.append("Weights that are missing, and how to get them:")
    for name in missing:
        lines += _describe_how_to_get(find_checkpoint(name), width)
    return "\n".join(lines).rstrip("\n") + "\n"


def planners_table(planners: tuple[PlannerListing, ...]) -> Table:
    """One row for each planner."""
    rows = [
        (
            TableCell(
                f"{planner.name} {MINIATURE_MARK}" if planner.miniature else planner.name, miniature=planner.miniature
            ),
            *(planner.sees, planner.weights, planner.gpu, _extra(planner)),
        )
        for planner in planners
    ]
    installed_notes = [
        f"{planner.name} is from an installed package: {planner.comes_from}."
        for planner in planners
        if planner.gpu == "?"
    ]
    extras = dict.fromkeys(planner.extra for planner in planners if planner.extra)
    also = [f"{name} is short for {planner.name}." for planner in planners for name in planner.also]
    return build_table(
        "models",
        "Planners that --model takes; your own is --model package.module:Class",
        ("planner", "sees", "weights", "GPU", "extra"),
        rows,
        notes=(
            f"{MINIATURE_WORDS} (docs/miniatures.md). On mini, a full model without weights is replaced by "
            "its miniature, with a notice.",
            "Boxes, the map and the recorded future are not available to a car: reference rows.",
            "Packaged weights carry the licences of their training data: adapters/weights/*.md.",
            *(f"{extra} is an extra of this package: pip install challenger-bench{extra}." for extra in extras),
            *also,
            *installed_notes,
        ),
        text_columns=5,
    )


def _list_built_in(model: Model, folder: Path) -> PlannerListing:
    also = tuple(name for name, other in MODELS.items() if other is model and name != model.name)
    if model.network is None:
        packaged = model.name in _PACKAGED_ALWAYS
        return PlannerListing(model.name, model.sees, "packaged" if packaged else "none needed", "no", also=also)
    weights = _weights(model, folder)
    extra_here = not model.extra or find_spec(model.extra_package) is not None
    return PlannerListing(
        model.name,
        _NETWORK_SEES,
        weights,
        "no" if model.miniature is not None else "helps",
        model.extra,
        weights != "missing" and extra_here,
        model.miniature is not None,
        also,
        model.weights or "",
    )


def _weights(model: Model, folder: Path) -> Weights:
    if model.miniature is not None:
        return "packaged" if model.packaged.is_file() else "missing"
    return "imported" if cached_weights(folder, model.weights) else "missing"


def _extra(planner: PlannerListing) -> str:
    if not planner.extra:
        return "–"
    return planner.extra if planner.here or planner.weights == "missing" else f"{planner.extra} (missing)"


def _describe_how_to_get(weights: PublishedWeights, width: int | None) -> list[str]:
    lines = [f"  {weights.name}: challenger-bench weights fetch {weights.name}, or with a browser:"]
    lines += [f"    {file.name}: {file.page or weights.address}" for file in weights.files]
    return [
        line
        for text in (*lines, f"    then {weights.how_to_import}", f"    licence: {weights.licence}")
        for line in wrap_text(text.strip(), width, indent=text[: len(text) - len(text.lstrip())], hanging="  ")
    ]


@cache
def _facts(name: str) -> PlannerFacts:
    return planner_factory(name).facts
