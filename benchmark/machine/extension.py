"""What an extension adds to a table of the core: named there, imported when somebody asks for it."""

import importlib
from typing import Any

from benchmark.errors import InputError


def absent_extension(error: ModuleNotFoundError) -> str | None:
    """Name of the extension that is not installed, if that is why an import failed."""
    parts = (error.name or "").split(".")
    return parts[2] if len(parts) > 2 and parts[1] == "extensions" else None


def not_installed(name: str) -> InputError:
    """What to say where an extension is missing."""
    return InputError(f"this needs the extension {name}, which is not installed here; install it")


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
    except ModuleNotFoundError as error:
        if (name := absent_extension(error)) is None:
            raise
        raise not_installed(name) from None
