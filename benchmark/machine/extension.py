"""What an extension adds to a table of the core: named there, imported when somebody asks for it."""

import importlib
from typing import Any

from benchmark.errors import InputError


def from_extension(reference: str) -> Any:
    """Import what a table names.

    Args:
        reference: ``package.extensions.name.module:attribute``.

    Returns:
        The attribute.

    Raises:
        InputError: If the extension is not installed.
    """
    module, _, attribute = reference.partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as absent:
        if absent.name is None or ".extensions." not in module or not f"{module}.".startswith(f"{absent.name}."):
            raise
        name = module.split(".")[2]
        raise InputError(f"this needs the extension {name}, which is not installed here; install it") from None
