"""Identity of a planner: its own attributes, which may be anything, as metadata that records can hold."""

import json
from operator import index
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json
from benchmark.planning import Planner, PrivilegedPlanner, reads_message_after, remembers_across_scenes
from benchmark.protocols import PROTOCOLS
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.code_identity import code_sha256, list_part_classes
from benchmark.untrusted.files import to_one_line

_LONGEST_SETTINGS: Final = 64 * 1024
"""Characters of them as JSON; they stand in every record."""
_DEEPEST_SETTINGS: Final = 16
_SEEDS: Final = 1 << 63
_DIGITS: Final = frozenset("0123456789abcdef")
_LENGTH: Final = 64
"""Hexadecimal digits of a SHA-256."""


def build_planner_facts(planner: Planner, made_by: str | None = None) -> PlannerFacts:
    """Identity of a planner, with the hash of the code that its plans depend on (`benchmark.runs.code_identity`).

    Its optional ``weights_sha256``, ``settings``, ``seed`` and ``native_protocol`` are taken over. ``made_by`` is the
    function or class that made it, as ``package.module:name``, if it was not built by hand.
    """
    whose = f"planner {planner.name!r}"
    settings = _settings(_read_attribute(planner, "settings", {}), whose)
    # These are recorded for every planner, third-party ones included.
    settings |= {"memory_crosses_scenes": True} if remembers_across_scenes(planner) else {}
    settings |= {"reads_message_after": True} if reads_message_after(planner) else {}
    seed, weights = (
        _seed(_read_attribute(planner, "seed", 0), whose),
        _weights(_read_attribute(planner, "weights_sha256", None), whose),
    )
    native = require_known_native(_read_attribute(planner, "native_protocol", None), whose)
    return PlannerFacts(
        name=planner.name,
        privileged=isinstance(planner, PrivilegedPlanner),
        weights_sha256=weights,
        code_sha256=code_sha256(type(planner), made_by=made_by, parts=list_part_classes(planner)),
        settings=settings,
        seed=seed,
        native_protocol=native,
    )


def require_known_native(name: str | None, whose: str) -> str | None:
    """Name of a planner's native protocol, once it is known to exist."""
    if name is not None and (not isinstance(name, str) or name not in PROTOCOLS):
        raise InputError(f"{whose} has the unknown native protocol {name!r}; choose from {', '.join(PROTOCOLS)}")
    return name


def _read_attribute(planner: Planner, attribute: str, default: Any) -> Any:
    """An attribute of a stranger's object: asking for it runs the stranger's code."""
    try:
        return getattr(planner, attribute, default)
    except Exception as error:
        raise InputError(
            f"reading {attribute} of planner {planner.name!r} raised {type(error).__name__}: {to_one_line(error)}"
        ) from error


def _settings(value: Any, whose: str) -> dict[str, Any]:
    try:
        settings = dict(value)
        if not all(isinstance(key, str) for key in settings):
            raise TypeError("their names must be text")
        text = canonical_json(settings)
        # Records are read to a limited depth, and invalid text cannot be shown.
        _require_shallow(settings, _DEEPEST_SETTINGS)
        json.dumps(settings, ensure_ascii=False).encode()
    except (TypeError, ValueError, RecursionError, AttributeError) as error:
        raise InputError(
            f"the settings of {whose} must be plain JSON values by name ({to_one_line(error)}); remove the others"
        ) from error
    if len(text) > _LONGEST_SETTINGS:
        raise InputError(
            f"the settings of {whose} have {len(text)} characters, too many to store in records; {_LONGEST_SETTINGS} "
            "are allowed: name a file by its hash instead"
        )
    return settings


def _require_shallow(value: Any, depth: int) -> None:
    if not depth:
        raise ValueError(f"they are nested more than {_DEEPEST_SETTINGS} deep")
    if isinstance(value, dict | list | tuple):
        for member in value.values() if isinstance(value, dict) else value:
            _require_shallow(member, depth - 1)


def _seed(value: Any, whose: str) -> int:
    try:
        seed = index(value)
    except TypeError:
        seed = -1
    if not 0 <= seed < _SEEDS:
        raise InputError(
            f"the seed of {whose} must be a whole number from 0 below 2^63, it is {to_one_line(repr(value))}"
        )
    return seed


def _weights(value: Any, whose: str) -> str | None:
    if value is None or (isinstance(value, str) and len(value) == _LENGTH and set(value) <= _DIGITS):
        return value
    raise InputError(
        f"the weights_sha256 of {whose} must be the SHA-256 of its weights file, {_LENGTH} hexadecimal digits; it is "
        f"{to_one_line(repr(value))}"
    )
