"""Planners by name: of the table (`adapters.models`), of installed packages, ``module:Class``, ``http://HOST:PORT``.

Planners of other packages are only built in a process of their own (`benchmark.sandbox`).
"""

import contextlib
import importlib
import inspect
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, TextIO

from adapters.models import MODELS, published_as
from adapters.planners.names import (
    add_current_folder,
    installed_planners,
    is_third_party,
    make_import_error,
    require_known,
)
from benchmark.errors import InputError
from benchmark.machine.address import find_scheme, is_address
from benchmark.machine.extension import OFFERS, import_reference
from benchmark.machine.several_devices import find_own_device
from benchmark.machine.storage import file_sha256
from benchmark.planning import Planner
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.plan_rows import FAILURES
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.sandbox.limits import SandboxLimits
from benchmark.sandbox.planner import PlannerIdentity, PlannerSpec, find_identity, make_sandboxed_planner

_MAKER_OF_NETWORKS = "adapters.checkpoints.loading:build_native_planner"
_MAKERS_BY_SCHEME = OFFERS["planner scheme"]
_CONTRACT = ("reset", "plan")
_LONGEST_NAME = 100
_BUILT_FROM = "adapters.registry:build_planner_with_facts"


@dataclass(frozen=True, slots=True)
class NamedPlanner:
    """Builds a planner by name in any process (`benchmark.runs.plan_rows.PlannerFactory`).

    `over_http` holds ``image_format``, ``deadline_s``, ``frame``; `supervision` limits of a process of its own, `None`
    for planners of this one; `identity` what a planner in a subprocess declares.
    """

    name: str
    checkpoint: Path | None
    seed: int
    facts: PlannerFacts
    device: str | None = None
    precision: str | None = None
    as_published: tuple[str, ...] = ()
    over_http: Mapping[str, Any] | None = None
    supervision: SandboxLimits | None = None
    identity: PlannerIdentity | None = None
    options: Mapping[str, Any] | None = None

    def __call__(self) -> Planner:
        """Build it; one with a process of its own is built there when a scene begins."""
        if self.supervision is not None and self.identity is not None:
            return make_sandboxed_planner(self._maker, self.identity, self.supervision)
        return build_planner(
            self.name,
            checkpoint=self.checkpoint,
            seed=self.seed,
            device=find_own_device(self.device),
            precision=self.precision,
            as_published=self.as_published,
            over_http=self.over_http,
        )

    @property
    def _maker(self) -> PlannerSpec:
        return _maker(
            self.name, self.checkpoint, seed=self.seed, device=find_own_device(self.device), precision=self.precision,
            as_published=self.as_published, options=self.options,
        )  # fmt: skip


def planner_factory(
    name: str,
    *,
    checkpoint: Path | None = None,
    data: Any = None,
    seed: int = 0,
    device: str | None = None,
    precision: str | None = None,
    as_published: Sequence[str] = (),
    over_http: Mapping[str, Any] | None = None,
    supervision: SandboxLimits | None = None,
    options: Mapping[str, Any] | None = None,
) -> NamedPlanner:
    """A planner that several processes can build; it is built once here, so that mistakes show at once.

    A planner of another package is built in a process of its own each time. `data` is for planners of this process;
    what needs the data set itself cannot be rebuilt elsewhere. `device` may name several, separated by commas
    (`benchmark.machine.several_devices`).
    """
    published = tuple(as_published)
    identity, limits = None, None
    if is_third_party(name):
        limits = supervision or SandboxLimits()
        maker = _maker(
            name, checkpoint, seed=seed, device=find_own_device(device), precision=precision, as_published=published,
            options=options,
        )  # fmt: skip
        identity = find_identity(maker, limits)
        facts = identity.facts
        _require_name(facts.name, name)
    else:
        _, facts = build_planner_with_facts(
            name,
            checkpoint=checkpoint,
            data=data,
            seed=seed,
            device=find_own_device(device),
            precision=precision,
            as_published=published,
            over_http=over_http,
        )
    settings = dict(facts.settings)
    if checkpoint is not None and checkpoint.is_file():
        settings |= {"checkpoint": checkpoint.name, "checkpoint_sha256": file_sha256(checkpoint)}
    known = {"settings": settings, "seed": seed, "published_as": published_as(facts.name)}
    model = MODELS.get(name)
    # A model server gets both; which parts of an observation other planners use is not known.
    known["wants"] = list(model.wants) if model is not None else ["images", "motion"] if is_address(name) else []
    if model is not None and model.network is not None:
        known["miniature"] = model.miniature is not None
    facts = facts.model_copy(update=known)
    return NamedPlanner(
        name, checkpoint, seed, facts, device, precision, published, over_http, limits, identity, options
    )


def build_planner_with_facts(name: str, **given: Any) -> tuple[Planner, PlannerFacts]:
    """Build a planner in this process, and say who it is."""
    built = build_planner(name, **given)
    return built, build_planner_facts(built, made_by=describe_maker(name))


def _maker(
    name: str,
    checkpoint: Path | None,
    *,
    seed: int,
    device: str | None,
    precision: str | None,
    as_published: tuple[str, ...],
    options: Mapping[str, Any] | None,
) -> PlannerSpec:
    require_known(name)
    given = {"checkpoint": checkpoint, "seed": seed, "device": device, "precision": precision, "options": options}
    return PlannerSpec(name, _BUILT_FROM, {"name": name, **given, "as_published": as_published})


def build_planner(
    name: str,
    *,
    checkpoint: Path | None = None,
    data: Any = None,
    seed: int = 0,
    device: str | None = None,
    precision: str | None = None,
    as_published: Sequence[str] = (),
    over_http: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Planner:
    """Build a planner that is built in, of an installed package, ``package.module:Class`` or a URL.

    Each option is given to planners that take an argument of its name, `over_http` to those behind HTTP, `options` are
    those that its extension declares. An unknown
    name, or a class that cannot be imported, is no planner, or takes no checkpoint, is an `InputError`.
    """
    require_known(name)
    installed = installed_planners()
    if name in MODELS and MODELS[name].network is not None:
        maker = partial(_import(_MAKER_OF_NETWORKS, name), MODELS[name])
    elif name in MODELS:
        maker = _import(MODELS[name].planner, name)
    elif name in installed:
        maker = _load(installed[name])
    elif (scheme := find_scheme(name)) is not None:
        maker = partial(import_reference(_MAKERS_BY_SCHEME[scheme]), name)
    else:
        add_current_folder()
        maker = _import(name, name)
    if checkpoint is not None and not checkpoint.exists():
        raise InputError(f"there is no checkpoint {checkpoint}")
    offered = {"checkpoint": checkpoint, "data": data, "seed": seed, "device": device, "precision": precision}
    offered |= options or {}
    if as_published:
        offered["as_published"] = tuple(as_published)
    if is_address(name):
        offered |= over_http or {}
    return _check_contract(_build(maker, name, offered), name)


def describe_maker(name: str) -> str:
    """Class or function that made a planner, as ``package.module:name``."""
    installed = installed_planners()
    if (scheme := find_scheme(name)) is not None:
        return _MAKERS_BY_SCHEME[scheme]
    if name in MODELS:
        return MODELS[name].planner if MODELS[name].network is None else _MAKER_OF_NETWORKS
    return f"{installed[name].module}:{installed[name].attr}" if name in installed else name


def _import(reference: str, name: str) -> Any:
    module_name, _, attribute = reference.partition(":")
    try:
        with _redirect_stdout():
            module = importlib.import_module(module_name)
    except ImportError as error:
        raise make_import_error(name, module_name, str(error)) from error
    except (ValueError, TypeError) as error:
        if not module_name or module_name.startswith("."):
            raise InputError(f"model {name!r} is not of the form package.module:Class") from error
        raise _planner_error(name, f"importing {module_name}", error) from error
    except FAILURES as error:
        raise _planner_error(name, f"importing {module_name}", error) from error
    target: Any = module
    for part in attribute.split("."):
        if not hasattr(target, part):
            raise InputError(f"model {name!r}: module {module_name} has no {attribute!r}")
        target = getattr(target, part)
    return target


def _load(point: EntryPoint) -> Any:
    try:
        with _redirect_stdout():
            return point.load()
    except FAILURES as error:
        raise InputError(
            f"model {point.name!r} is installed as {point.value} but cannot be imported: {error}"
        ) from error


def _build(maker: Any, name: str, offered: dict[str, Any]) -> Any:
    """Call a class or function with those of `offered` that it takes."""
    if not callable(maker):
        raise InputError(f"model {name!r} is a {type(maker).__name__}, not a class or a function that makes a planner")
    try:
        parameters = inspect.signature(maker).parameters.values()
    except ValueError as error:
        raise InputError(f"model {name!r} is {maker!r}, not a class or a function that makes a planner") from error
    takes_any = any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters)
    taken = {parameter.name for parameter in parameters}
    for option in ("checkpoint", "device", "precision", "as_published"):
        if offered.get(option) is not None and not takes_any and option not in taken:
            option_name = option.replace("_", "-")
            raise InputError(f"model {name!r} does not take --{option_name}; leave it out")
    missing = [
        parameter.name
        for parameter in parameters
        if parameter.default is inspect.Parameter.empty
        and parameter.kind not in (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
        and offered.get(parameter.name) is None
    ]
    if missing:
        raise InputError(f"model {name!r} needs arguments without defaults: {', '.join(missing)}; give them defaults")
    arguments = {key: value for key, value in offered.items() if (takes_any or key in taken) and value is not None}
    try:
        with _redirect_stdout():
            return maker(**arguments)
    except InputError:
        raise
    except FAILURES as error:
        raise _planner_error(name, "building it", error) from error


def _redirect_stdout() -> contextlib.redirect_stdout[TextIO]:
    """Stdout belongs to the command (``--json``); what a stranger's code prints goes to stderr."""
    return contextlib.redirect_stdout(sys.stderr)


def _planner_error(name: str, doing: str, error: BaseException) -> InputError:
    reason = (str(error).splitlines() or [""])[0]
    return InputError(
        f"model {name!r}: {doing} raised {type(error).__name__}{': ' if reason else ''}{reason}; --debug shows where"
    )


def _check_contract(built: Any, name: str) -> Planner:
    missing = [method for method in _CONTRACT if not callable(getattr(built, method, None))]
    if missing:
        raise InputError(
            f"model {name!r} is not a planner: it has no method {' and no method '.join(missing)}; a planner has "
            "reset(scene), plan(observation) -> Plan and a name (benchmark/planning.py)"
        )
    try:
        called = getattr(built, "name", None)
    except FAILURES as error:
        raise _planner_error(name, "asking for its name", error) from error
    _require_name(called, name)
    typed: Planner = built
    return typed


def _require_name(called: Any, name: str) -> None:
    if not isinstance(called, str) or not called:
        raise InputError(f"model {name!r} has no name; set the attribute name, a string that tables show")
    if not called.isprintable() or len(called) > _LONGEST_NAME:
        raise InputError(
            f"model {name!r} has the name {called[:40]!r}; a name is at most {_LONGEST_NAME} printable characters"
        )
