"""Names of planners: of the table, of installed packages, ``module:Class``, ``http://HOST:PORT``; none is imported."""

import importlib.util
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from adapters.models import MODELS
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.address import SCHEMES, Address, is_address
from benchmark.machine.extension import list_offers

ENTRY_POINT_GROUP = "challenger_bench.adapters"


def is_third_party(name: str) -> bool:
    """Whether a planner comes from another package, and runs in a subprocess."""
    return name not in MODELS and not is_address(name)


def require_known(name: str) -> None:
    """Raise `InputError` for what names no planner; nothing of it is imported."""
    known = (*MODELS, *installed_planners())
    if is_address(name):
        if (called := Address.of(name, "--model", SCHEMES).name) in known:
            raise InputError(f"{called} is already the name of a planner; give the server at {name} another name")
        return
    module, colon, attribute = name.partition(":")
    if name not in known and (module.endswith(".py") or "/" in module):
        raise _file_name_error(name, Path(module), attribute)
    if name not in known and not colon:
        raise InputError(
            f"unknown model {name!r}; {did_you_mean(name, known)}use {', '.join(known)}, or your own with --model "
            "package.module:Class"
        )
    if name not in known and _is_absent(module.partition(".")[0]):
        raise make_import_error(name, module, f"No module named {module.partition('.')[0]!r}")


def _file_name_error(name: str, file: Path, attribute: str) -> InputError:
    """Refusal of a file where a module is wanted, with the module's name; of one elsewhere, from its folder."""
    elsewhere = file.is_absolute() or ".." in file.parts
    module = file.stem if elsewhere else ".".join(file.with_suffix("").parts)
    how = f"run the command in {file.parent} with" if elsewhere else "use"
    return InputError(
        f"model {name!r} names a file where a module is wanted; {how} --model {module}:{attribute or 'Class'}"
    )


def _is_absent(package: str) -> bool:
    """Whether there is no package or module of a name, here or in the current folder."""
    add_current_folder()
    try:
        return bool(package) and package not in sys.modules and importlib.util.find_spec(package) is None
    except (ImportError, ValueError):
        return False


def make_import_error(name: str, module: str, why: str) -> InputError:
    """Refusal of a planner whose module cannot be imported."""
    return InputError(
        f"model {name!r}: cannot import {module} ({why}); run the command in the folder that holds "
        f"{module.partition('.')[0]}, put that on PYTHONPATH, or install it in this environment"
    )


def installed_planners() -> dict[str, EntryPoint]:
    """Planners of installed packages, by name; built-in names cannot be taken over."""
    offered = list_offers("planner", MODELS)
    points = [EntryPoint(name, reference, ENTRY_POINT_GROUP) for name, reference in offered.items()]
    points += entry_points(group=ENTRY_POINT_GROUP)
    return {point.name: point for point in sorted(points, key=lambda point: point.name) if point.name not in MODELS}


def add_current_folder() -> None:
    """Find modules in the current folder as ``python -m`` does; an installed command does not look there."""
    folder = str(Path.cwd())
    if not {"", folder} & set(sys.path):
        sys.path.insert(0, folder)
