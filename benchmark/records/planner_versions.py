"""Names that tell apart several versions of one planner: two checkpoints, two seeds, two settings, two plan files."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from benchmark.records.run import RunRecord
from benchmark.records.run_schema import AS_PUBLISHED, PlanFileFacts, PlannerFacts


def list_file_notes(records: Iterable[RunRecord]) -> list[str]:
    """One sentence for each run whose plans come from a file: how it is known which sample each belongs to."""
    return [
        f"{record.planner} on {record.run.split}: plans from a file ({plans_from.format}), samples "
        f"{describe_sample_order(plans_from)}."
        for record in records
        if (plans_from := record.run.plans_from) is not None
    ]


def describe_sample_order(plans_from: PlanFileFacts) -> str:
    """Words on how the samples of a file are known, to stand behind "samples"."""
    known = "named by the file" if plans_from.order == "tokens" else f"in an order that is {plans_from.order}"
    return f"{known} ({plans_from.shown_by})"


PLANS_SHA256 = "plans_sha256"
"""Setting of a planner whose plans come from a file: the file's hash."""
_OF_ONE_SPLIT = frozenset({PLANS_SHA256})
"""Settings that differ between splits of one version: a plan file holds one split."""
_HASH_CHARACTERS = 8
PlannerOnSplit = tuple[PlannerFacts, str, str]
"""Planner, data set and split of a run."""


def label_versions(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Records whose `RunRecord.planner` is unlike that of every other version of the planner among them.

    A planner that ran in one version keeps its name. Otherwise what differs is added: ``vad-base (seed 1)``,
    ``vad-base (weights 3fa2b1c0)``. Versions that differ in their code alone are told apart by nothing: the same
    planner at two commits is not two planners. Plan files tell versions apart only where two of them are of one split.
    """
    version_labels = compute_version_labels(
        [(record.run.planner, record.run.data.name, record.run.split) for record in records]
    )
    return [replace(record, label=label) for record, label in zip(records, version_labels, strict=True)]


def compute_version_labels(ran: Sequence[PlannerOnSplit]) -> list[str | None]:
    """Names as of `label_versions` for planners on (data set, split); ``None`` for a planner in one version only."""
    versions_by_name: dict[str, list[PlannerOnSplit]] = {}
    for version in ran:
        versions_by_name.setdefault(version[0].name, []).append(version)
    telling = {name: _find_distinguishing_facts(versions) for name, versions in versions_by_name.items()}
    return [_label(planner, telling[planner.name]) for planner, _, _ in ran]


def _find_distinguishing_facts(ran: Sequence[PlannerOnSplit]) -> list[str]:
    versions = [describe_version(planner) for planner, _, _ in ran]
    names = sorted({name for version in versions for name in version})
    return [name for name in names if _differs(name, ran, [version.get(name) for version in versions])]


def _differs(name: str, ran: Sequence[PlannerOnSplit], values: Sequence[str | None]) -> bool:
    if name not in _OF_ONE_SPLIT:
        return len(set(values)) > 1
    places = [(data, split) for _, data, split in ran]
    return len(set(zip(places, values))) > len(set(places))


def describe_version(planner: PlannerFacts) -> dict[str, str]:
    """Differences between versions of planners, as text by their kind."""
    # Older records also name the code of native planners in their settings (shared_code_sha256).
    settings = {name: value for name, value in planner.settings.items() if not name.endswith("code_sha256")}
    facts: dict[str, Any] = {"seed": planner.seed, **settings}
    if AS_PUBLISHED in facts:
        # It implies these.
        facts.pop("reads_message_after", None)
        facts |= {"memory_crosses_scenes": False} if "memory_crosses_scenes" in facts else {}
    if planner.weights_sha256 is not None:
        # The hash identifies the file, so its name is not needed.
        facts = {name: value for name, value in facts.items() if not name.startswith("checkpoint")}
        facts["weights"] = planner.weights_sha256
    return {name: _format_fact(name, value) for name, value in facts.items()}


def _format_fact(name: str, value: Any) -> str:
    is_hash = isinstance(value, str) and (name == "weights" or name.endswith("sha256"))
    return value[:_HASH_CHARACTERS] if is_hash else str(value)


def _label(planner: PlannerFacts, telling: Sequence[str]) -> str | None:
    if not telling:
        return None
    version = describe_version(planner)
    differences = ", ".join(f"{name} {version.get(name, 'none')}" for name in telling)
    return f"{planner.name} ({differences})"
