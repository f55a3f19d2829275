"""Foreign TOML: small files that people write by hand."""

import tomllib
from pathlib import Path
from typing import Any

from benchmark.errors import InputError
from benchmark.untrusted.files import one_line, read_file
from benchmark.untrusted.limits import SETTINGS, Limits


def read_toml(path: Path, limits: Limits = SETTINGS) -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: The file.
        limits: How large it may be.

    Returns:
        Its tables.

    Raises:
        InputError: If it is absent, unreadable, too large or not TOML.
    """
    return parse_toml(read_file(path, limits), str(path))


def parse_toml(data: bytes, where: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Args:
        data: UTF-8 text.
        where: What it is called in the message.

    Returns:
        The tables.

    Raises:
        InputError: If it is not TOML.
    """
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where} is not valid TOML ({one_line(error) or 'nested too deeply'}); correct it") from error
