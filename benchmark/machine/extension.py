"""Contributions of extensions to the core: one table of kinds, names and where each is defined.

Nothing is imported before it is requested by name; an extension that is not installed is reported in one sentence.
"""

import importlib
import importlib.util
from collections.abc import Mapping
from typing import Any, Final

from benchmark.errors import InputError

OFFERS: Final[Mapping[str, Mapping[str, str]]] = {
    # A Typer application, or a function that becomes a command, by the words of the command.
    "command": {
        "data card": "benchmark.extensions.cards.cli:data_card_command",
        "leaderboard card": "benchmark.extensions.cards.cli:records_card_command",
        "challenge": "benchmark.extensions.challenge.cli:app",
        "data export scenarionet": "benchmark.extensions.exchange.cli:export_scenarionet_command",
        "data export openscenario": "benchmark.extensions.exchange.cli:export_openscenario_command",
        "data export infos": "benchmark.extensions.infos.cli:export_infos_command",
        "film": "leaderboard.extensions.films.cli:film_command",
        "serve": "benchmark.extensions.http.cli:serve_command",
        "quality": "benchmark.extensions.quality.cli:quality_command",
        "reproduce": "benchmark.extensions.reproduce.cli:reproduce_command",
        "data review": "benchmark.extensions.review.cli:data_review_command",
        "leaderboard submit-check": "benchmark.extensions.submissions.cli:submit_check_command",
        "train": "adapters.extensions.training.cli:app",
    },
    # From the engine's name and its scenarios to a `closed_loop.simulation_state.SimulatorBackend`.
    "engine": {
        "neuroncap@code": "benchmark.extensions.neuroncap.simulation_state:build_neuroncap_backend",
        "neuroncap@paper": "benchmark.extensions.neuroncap.simulation_state:build_neuroncap_backend",
    },
    # From settings to a `closed_loop.adversary.AdversaryFactory`.
    "agents": {"adversary": "generation.extensions.reactive_adversary.adversary_maker:build_reactive_adversary_maker"},
    # From an address to a planner, and to a `closed_loop.sensors.Sensor`; by scheme.
    "planner": {"http": "benchmark.extensions.http.model:http_planner"},
    "sensor": {"http": "benchmark.extensions.http.sensor:HttpSensor"},
    # From the options of ``generate`` to an object that checks them and makes a `generation.render.contract.Renderer`.
    "renderer": {"magicdrive": "generation.extensions.magicdrive.cli:PhotorealisticOptions"},
    # Pictures of scenes for ``data show``.
    "pictures": {"conditions": "generation.extensions.magicdrive.condition_pictures:write_condition_pictures"},
    # From records of a kind to `leaderboard.page.sections.Section`, in the order of the page.
    "section": {
        "challenges": "leaderboard.extensions.challenge.tables:build_sections",
        "quality": "leaderboard.extensions.quality.tables:build_sections",
    },
    # From run records to pictures of disagreements between protocols.
    "judge": {"explanation": "benchmark.extensions.explain.pictures:explain"},
    # From a folder to findings that should not be published.
    "check": {"publishing": "leaderboard.extensions.publishing.checking:check_publishable"},
    # From the bytes of a member of a package of splits to the same bytes, or `InputError`.
    "package": {"rules": "benchmark.extensions.challenge.rules:validate_rules"},
    # `GoldenSet`, but for ``model``: from a model and a folder of golden numbers to checks.
    "golden set": {
        "physics": "generation.extensions.golden_sets.physics:GOLDEN",
        "scoring": "generation.extensions.golden_sets.scoring:GOLDEN",
        "denoiser": "generation.extensions.golden_sets.denoiser:GOLDEN",
        "protocols": "benchmark.extensions.golden_sets.protocols:GOLDEN",
        "pdm": "benchmark.extensions.golden_sets.pdm:GOLDEN",
        "results": "adapters.extensions.golden_sets.result_files:GOLDEN",
        "drivers": "benchmark.extensions.golden_sets.drivers:GOLDEN",
        "severity": "benchmark.extensions.golden_sets.severity:GOLDEN",
        "realism": "benchmark.extensions.golden_sets.realism:GOLDEN",
        "infos": "benchmark.extensions.infos.verification:GOLDEN",
        "neuroncap": "benchmark.extensions.neuroncap.verification:GOLDEN",
        "model": "adapters.extensions.golden_sets.models:verify_model",
    },
    "golden set of a renderer": {
        "magicdrive": "generation.extensions.magicdrive.verification.comparison:verify_magicdrive"
    },
}
"""By kind and name: ``package.extensions.name.module:attribute``."""


class AbsentExtensionError(InputError):
    """An extension is not installed."""


def parse_extension_name(reference: str) -> str:
    """Name of the extension that a reference leads to."""
    return reference.split(".")[2]


def find_absent_extension(error: ModuleNotFoundError) -> str | None:
    """Name of the extension that is not installed, if that is why an import failed."""
    parts = (error.name or "").split(".")
    return parts[2] if len(parts) > 2 and parts[1] == "extensions" else None


def make_absent_error(name: str) -> AbsentExtensionError:
    """The error where an extension is missing."""
    return AbsentExtensionError(f"this needs the extension {name}, which is not installed; install it")


def import_from_extension(kind: str, name: str) -> Any:
    """Import an object of a kind of `OFFERS` from its extension; `AbsentExtensionError` if that is not installed."""
    return import_reference(OFFERS[kind][name])


def import_reference(reference: str) -> Any:
    """Import ``module:attribute`` of the core or an extension; `AbsentExtensionError` if that is not installed."""
    module, _, attribute = reference.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        if (name := find_absent_extension(error)) is None:
            raise
        raise make_absent_error(name) from None


def require_package(module: str, sentence: str) -> None:
    """Raise `InputError` with a sentence where an optional package is not installed; nothing is imported."""
    if importlib.util.find_spec(module) is None:
        raise InputError(sentence)
