"""Options of commands as what they become."""

from dataclasses import fields
from typing import Any


def named_alike(target: type, options: Any) -> dict[str, Any]:
    """Values of those options that are called as fields of a dataclass."""
    return {each.name: getattr(options, each.name) for each in fields(target) if hasattr(options, each.name)}
