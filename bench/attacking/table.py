"""The table of what is attacked, ``attacked.toml`` beside this file, and its command lines."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any, Final

TABLE: Final[dict[str, Any]] = tomllib.loads((Path(__file__).parent / "attacked.toml").read_text())


def arguments(line: str, words: Mapping[str, str] = TABLE["words"]) -> tuple[str, ...]:
    """The arguments of a line of a table, with places in braces; ``$WORDS`` stand for what many lines share."""
    return tuple(Template(line).substitute(words).split())
