"""The table of what is attacked, ``attacked.toml`` beside this file, and its command lines."""

import tomllib
from pathlib import Path
from string import Template
from typing import Any, Final

TABLE: Final[dict[str, Any]] = tomllib.loads((Path(__file__).parent / "attacked.toml").read_text())


def arguments(line: str) -> tuple[str, ...]:
    """The arguments of a line of the table, with places in braces."""
    return tuple(Template(line).substitute(TABLE["words"]).split())
