"""Names that tell apart several versions of one planner: two checkpoints, two seeds, two settings."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from benchmark.records import RunRecord

_HASH_CHARACTERS = 8


def labelled(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Records whose `RunRecord.planner` is unlike that of every other version of the planner among them.

    A planner that ran in one version keeps its name. Otherwise what differs is added: ``vad-base (seed 1)``,
    ``vad-base (weights 3fa2b1c0)``. Versions that differ in their code alone are told apart by nothing: the same
    planner at two commits is not two planners.

    Args:
        records: Any records.

    Returns:
        The same records, in their order.
    """
    versions: dict[str, list[dict[str, str]]] = {}
    for record in records:
        known = versions.setdefault(record.run.planner.name, [])
        if (version := _version(record)) not in known:
            known.append(version)
    return [replace(record, label=_label(record, versions[record.run.planner.name])) for record in records]


def _version(record: RunRecord) -> dict[str, str]:
    """What tells versions of a planner apart, as text by what it is."""
    planner = record.run.planner
    facts: dict[str, Any] = {"seed": planner.seed, **planner.settings}
    if planner.weights_sha256 is not None:
        facts["weights"] = planner.weights_sha256
    return {name: _shown(name, value) for name, value in facts.items()}


def _shown(name: str, value: Any) -> str:
    is_hash = isinstance(value, str) and (name == "weights" or name.endswith("sha256"))
    return value[:_HASH_CHARACTERS] if is_hash else str(value)


def _label(record: RunRecord, versions: Sequence[dict[str, str]]) -> str | None:
    if len(versions) < 2:
        return None
    own = _version(record)
    names = sorted({name for version in versions for name in version})
    differing = [name for name in names if len({version.get(name) for version in versions}) > 1]
    said = ", ".join(f"{name} {own.get(name, 'none')}" for name in differing)
    return f"{record.run.planner.name} ({said})"
