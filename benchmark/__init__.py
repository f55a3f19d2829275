"""The harness, and the Python face of all four packages: every command has its function here (docs/python.md).

``__init__.pyi`` declares the names and where each is defined, for type checkers too. They are looked up when they are
asked for, so that ``import benchmark`` answers at once and a missing extra breaks only what needs it.
"""

import ast
from pathlib import Path
from typing import Any

from benchmark.constants import VERSION

__version__ = VERSION


def _read_declared_names() -> tuple[list[str], dict[str, str]]:
    """Names that are shown, and of every name ``module:attribute``, as the stub declares them."""
    names, places = [], {}
    for node in ast.parse(Path(__file__).with_name("__init__.pyi").read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            places |= {str(alias.asname): f"{node.module}:{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Assign):
            names = ast.literal_eval(node.value)
    return names, places


__all__, _PLACES = _read_declared_names()


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from benchmark.errors import InputError
    from benchmark.machine.extension import import_reference

    try:
        value = import_reference(_PLACES[name])
    except InputError as absent:
        raise AttributeError(f"benchmark.{name}: {absent}") from None
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
