"""Contributions of extensions to the core: one table of kinds, names and where each is defined.

Other packages add to it by entry points (docs/extending.md). Nothing is imported before it is requested by name; an
extension that is not installed, or does not work, is reported in one sentence.
"""

import contextlib
import importlib
import importlib.util
import sys
from collections.abc import Collection, Mapping
from functools import cache
from importlib.metadata import entry_points
from typing import Any, Final

from benchmark.errors import InputError

OFFERS: Final[Mapping[str, Mapping[str, str]]] = {
    # A Typer application, or a function that becomes a command, by the words of the command.
    "command": {
        "data card": "benchmark.extensions.cards.cli:data_card_command",
        "leaderboard card": "benchmark.extensions.cards.cli:records_card_command",
        "leaderboard ability": "leaderboard.extensions.ability.cli:ability_command",
        "leaderboard next": "leaderboard.extensions.ability.cli:next_command",
        "challenge": "benchmark.extensions.challenge.cli:app",
        "data export scenarionet": "benchmark.extensions.exchange.cli:export_scenarionet_command",
        "data export openscenario": "benchmark.extensions.exchange.cli:export_openscenario_command",
        "data export nuscenes": "benchmark.extensions.exchange.cli:export_nuscenes_command",
        "data export mcap": "benchmark.extensions.mcap.cli:export_mcap_command",
        "data export infos": "benchmark.extensions.infos.cli:export_infos_command",
        "data import 123d": "generation.extensions.logs123d.cli:import_123d_command",
        "film": "leaderboard.extensions.films.cli:film_command",
        "quality": "benchmark.extensions.quality.cli:quality_command",
        "reproduce": "benchmark.extensions.reproduce.cli:reproduce_command",
        "data review": "benchmark.extensions.review.cli:data_review_command",
        "leaderboard export-alpasim": "benchmark.extensions.alpasim_table.cli:export_alpasim_command",
        "leaderboard submit-check": "benchmark.extensions.submissions.cli:submit_check_command",
        "train": "adapters.extensions.training.cli:app",
    },
    # From the engine's name and its scenarios, and facts of them (ours alone), to a
    # `closed_loop.simulation_state.SimulatorBackend`.
    "engine": {
        "neuroncap@code": "benchmark.extensions.neuroncap.simulation_state:build_neuroncap_backend",
        "neuroncap@paper": "benchmark.extensions.neuroncap.simulation_state:build_neuroncap_backend",
    },
    # From settings to a `closed_loop.adversary.AdversaryFactory`.
    "agents": {"adversary": "generation.extensions.reactive_adversary.adversary_maker:build_reactive_adversary_maker"},
    # From an address to the same; by scheme.
    "agents scheme": {"grpc": "benchmark.extensions.alpasim.traffic.client:build_remote_traffic"},
    # From a scene and a `closed_loop.episodes.Episode` in it to parts of further scores, by the name of their column.
    "drive score": {"alpasim": "benchmark.extensions.alpasim_score.drives:score_by_alpasim"},
    # A `benchmark.planning.Planner` by name, with its options.
    "planner": {},
    # From an address to a planner, and to a `closed_loop.sensors.Sensor`; by scheme.
    "planner scheme": {
        "http": "benchmark.extensions.http.model:http_planner",
        "grpc": "benchmark.extensions.alpasim.model:egodriver_planner",
    },
    # From nothing to a `benchmark.machine.listening.ServingProtocol` of ``serve``.
    "protocol": {
        "neuroncap": "benchmark.extensions.http:describe_protocol",
        "alpasim": "benchmark.extensions.alpasim:describe_protocol",
        "alpasim-traffic": "benchmark.extensions.alpasim:describe_traffic_protocol",
    },
    "sensor": {"http": "benchmark.extensions.http.sensor:HttpSensor"},
    # From the options of ``generate`` and its own to a `generation.render.contract.RendererSource`.
    "renderer": {"magicdrive": "generation.extensions.magicdrive.cli:read_photorealistic_options"},
    # A dataclass of settings (`benchmark.cli.settings`) by kind and name of what it is for: ``renderer NAME`` adds to
    # ``generate``, ``planner NAME`` (or its scheme) to ``eval`` and ``drive``, ``protocol NAME`` to ``serve``. The
    # values are given as keyword arguments.
    "options": {
        "planner grpc": "benchmark.extensions.alpasim.cli:EgodriverOptions",
        "protocol neuroncap": "benchmark.extensions.http.cli:NeuroncapServeOptions",
        "protocol alpasim": "benchmark.extensions.alpasim.cli:AlpasimServeOptions",
        "protocol alpasim-traffic": "benchmark.extensions.alpasim.cli:AlpasimTrafficOptions",
    },
    # Parts of the search for adversaries that presets ask for.
    "search": {
        "behaviour": "generation.extensions.effect.behaviour:find_behaviour_fault",
        "retiming": "generation.extensions.effect.retiming:iterate_retimings",
        "conflicts": "generation.extensions.effect.conflicts:describe_conflicts",
        "panel": "generation.extensions.effect.panel:rank_by_effect",
        "ego": "generation.extensions.reactive_adversary.driven_ego:drive_undisturbed",
        "pressing": "generation.extensions.reactive_adversary.pressing:PressingPlanning",
    },
    # Pictures of scenes for ``data show``.
    "pictures": {"conditions": "generation.extensions.magicdrive.condition_pictures:write_condition_pictures"},
    # Names of recordings that mean nuScenes' (`benchmark.datasets.categories.choose_names`).
    "names": {
        "rig": "benchmark.extensions.own_recordings.rigs:read_rig",
        "file": "benchmark.extensions.own_recordings.names:flatten_names",
        "choose": "benchmark.extensions.own_recordings.names:choose_names",
        "missing views": "benchmark.extensions.own_recordings.rigs:name_missing_views",
        "caveats": "benchmark.extensions.own_recordings.rig_notes:list_caveats",
    },
    # From records of a kind to `leaderboard.page.sections.Section`, in the order of the page.
    "section": {
        "abilities": "leaderboard.extensions.ability.tables:build_sections",
        "challenges": "leaderboard.extensions.challenge.tables:build_sections",
        "quality": "leaderboard.extensions.quality.tables:build_sections",
    },
    # From an output folder, run records and records of drives to records of a kind of ``section``.
    "records": {"abilities": "leaderboard.extensions.ability.fit:find_fits"},
    # From an output folder, names of a data set and a split or ``None`` to tables for ``data stats``.
    "statistics": {"abilities": "leaderboard.extensions.ability.tables:list_statistics"},
    # From `leaderboard.frame.runs.DataSetRuns` to tables of the data set.
    "table": {},
    # From records of drives through a data set to tables of them.
    "drive table": {"alpasim": "leaderboard.extensions.alpasim_score.tables:alpasim_tables"},
    # From `leaderboard.frame.results.LeaderboardResults` to the text of an HTML page of the site.
    "page": {},
    # A `benchmark.protocols.contract.CollisionProtocol`, made without arguments, that ``--protocol`` names.
    "judge": {},
    # From run records to pictures of disagreements between protocols.
    "explanation": {"protocols": "benchmark.extensions.explain.pictures:explain"},
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
        "fault": "benchmark.extensions.golden_sets.fault:GOLDEN",
        "ability": "leaderboard.extensions.ability.verification:GOLDEN",
        "infos": "benchmark.extensions.infos.verification:GOLDEN",
        "hub": "benchmark.extensions.cards.hub_verification:GOLDEN",
        "import-123d": "generation.extensions.logs123d.verification:GOLDEN",
        "neuroncap": "benchmark.extensions.neuroncap.verification:GOLDEN",
        "alpasim sessions": "benchmark.extensions.alpasim.verification:SESSIONS",
        "alpasim traffic": "benchmark.extensions.alpasim.traffic.verification:SESSIONS",
        "alpasim reactions": "benchmark.extensions.alpasim.traffic.verification:REACTIONS",
        "ability alpasim": "benchmark.extensions.alpasim_table.verification:GOLDEN",
        "ability alpasim-refused": "benchmark.extensions.alpasim_table.verification:REFUSED",
        "alpasim score": "benchmark.extensions.alpasim_score.verification:GOLDEN",
        "model": "adapters.extensions.golden_sets.models:verify_model",
    },
    "golden set of a renderer": {
        "magicdrive": "generation.extensions.magicdrive.verification.comparison:verify_magicdrive"
    },
}
"""By kind and name: ``package.extensions.name.module:attribute``."""
GROUP: Final = "challenger_bench.extensions"
"""Entry points of other packages: each names a table in the form of `OFFERS`; the module of it is imported for help."""
OPEN_KINDS: Final = ("command", "engine", "judge", "options", "page", "planner", "renderer", "table")
"""What other packages may offer."""


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


def list_offers(kind: str, core: Collection[str] = ()) -> dict[str, str]:
    """References of a kind by name: ours, then those of other packages, without names that the core has itself."""
    others = {name: reference for name, (_, reference) in _read_other_packages().get(kind, {}).items()}
    for name in core if others else ():
        if others.pop(name, None) is not None:
            warn(f"the {kind} {name} of the extension {find_owner(kind, name)} is left out: the core has that name")
    return {**OFFERS[kind], **others}


def find_owner(kind: str, name: str) -> str:
    """Name of the extension that offers something: ours, or the entry point of another package."""
    ours = OFFERS[kind].get(name)
    return _read_other_packages()[kind][name][0] if ours is None else parse_extension_name(ours)


@cache
def _read_other_packages() -> dict[str, dict[str, tuple[str, str]]]:
    """Name of the extension and reference, by kind and name; what is refused is said once on standard error."""
    found: dict[str, dict[str, tuple[str, str]]] = {}
    for entry in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        try:
            offered = [(kind, name, str(of)) for kind, names in entry.load().items() for name, of in names.items()]
        except Exception as error:
            warn(f"the extension {entry.name} is left out, its table cannot be read ({_describe(error)}); reinstall it")
            continue
        for kind, name, reference in offered:
            taken = kind in OPEN_KINDS and {**OFFERS[kind], **found.get(kind, {})}.get(name)
            if kind not in OPEN_KINDS:
                warn(f"the extension {entry.name} offers the kind {kind}, which is none of {', '.join(OPEN_KINDS)}")
            elif taken:
                owner = parse_extension_name(taken) if isinstance(taken, str) else taken[0]
                warn(f"the extension {entry.name} offers the {kind} {name}, which {owner} offers already; rename it")
            else:
                found.setdefault(kind, {})[name] = entry.name, reference
    return found


@cache
def warn(sentence: str) -> None:
    """Say something about other packages on standard error, once."""
    print(f"warning: {sentence}", file=sys.stderr)


def _describe(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def import_from_extension(kind: str, name: str) -> Any:
    """Import what an extension offers; `AbsentExtensionError` if one of ours is not installed.

    What is raised by another package's import is an `InputError` that names the package.
    """
    reference = list_offers(kind)[name]
    if name in OFFERS[kind]:
        return import_reference(reference)
    try:
        return import_reference(reference)
    except Exception as error:
        raise InputError(
            f"the {kind} {name} of the extension {find_owner(kind, name)} cannot be imported ({_describe(error)}); "
            "reinstall or remove it"
        ) from error


def call_extension(kind: str, name: str, *arguments: Any, **options: Any) -> Any:
    """Call what an extension offers; what another package raises is an `InputError` that names it."""
    called = import_from_extension(kind, name)
    if name in OFFERS[kind]:
        return called(*arguments, **options)
    try:
        return called(*arguments, **options)
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"the {kind} {name} of the extension {find_owner(kind, name)} failed ({_describe(error)}); see --debug"
        ) from error


def call_installed(kind: str, *arguments: Any) -> list[Any]:
    """What each extension that is installed here makes of something."""
    found = []
    for name in list_offers(kind):
        with contextlib.suppress(AbsentExtensionError):
            found.append(call_extension(kind, name, *arguments))
    return found


def import_reference(reference: str) -> Any:
    """Import ``module:attribute`` of the core or an extension; `AbsentExtensionError` if that is not installed."""
    module, _, attribute = reference.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        if (name := find_absent_extension(error)) is None:
            raise
        raise make_absent_error(name) from None


def require_extra(module: str, what: str, extra: str) -> None:
    """Raise `InputError` where what is done needs an optional package of one of our extras; nothing is imported."""
    advice = f"install it with: pip install 'challenger-bench[{extra}]'"
    require_package(module, f"{what} needs the package {module}; {advice}")


def require_package(module: str, sentence: str) -> None:
    """Raise `InputError` with a sentence where an optional package is not installed; nothing is imported."""
    try:
        found = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        # Of a package that it is in.
        found = None
    if found is None:
        raise InputError(sentence)
