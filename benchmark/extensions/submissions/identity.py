"""Who planned: what this version knows of its own planners, and what stays a declaration of whoever submits."""

import re
from collections.abc import Callable, Iterator
from typing import Final

from benchmark.extensions.submissions.findings import Level, Said
from benchmark.protocols import PROTOCOLS
from benchmark.records.run_schema import PlannerFacts, RecordFacts

OursLike = Callable[[PlannerFacts], PlannerFacts | None]
"""The planner of this program that a submitted one is by its code, else the one that it is called like, else none."""
_SHA256: Final = re.compile(r"[0-9a-f]{64}")
_OWN_WEIGHTS: Final = "checkpoint_sha256"
"""Setting of a planner that was given another file than its own."""


def planner_findings(facts: RecordFacts, ours_like: OursLike) -> Iterator[Said]:
    """Compare a record's claims about its planner with the planner itself."""
    planner = facts.planner
    for what, claimed in (("weights", planner.weights_sha256), ("code", planner.code_sha256)):
        if claimed is not None and not _SHA256.fullmatch(claimed):
            yield Level.ERROR, f"names {what} {claimed[:80]!r}, which is no SHA-256 (64 hexadecimal digits)"
    if planner.native_protocol is not None and planner.native_protocol not in PROTOCOLS:
        yield Level.ERROR, f"names a protocol of its own, {planner.native_protocol!r}, which this version does not know"
    if planner.weights_sha256 is None and planner.code_sha256 is None:
        yield Level.NOTE, "names neither weights nor code (plans from a file): nobody can tell which model planned"
    if planner.privileged:
        yield Level.NOTE, "is privileged: the planner saw boxes, the map or the recorded future, and tables say so"
    source = facts.environment.get("source")
    if isinstance(source, dict) and source.get("dirty"):
        yield Level.NOTE, "was made with uncommitted changes to challenger-bench"
    ours = ours_like(planner)
    if ours is not None and ours.code_sha256 == planner.code_sha256:
        yield from _not_as_ours(planner, ours)
    else:
        yield Level.NOTE, _declared(planner, ours)


def _not_as_ours(planner: PlannerFacts, ours: PlannerFacts) -> Iterator[Said]:
    """Where a planner with the code of ours says of itself what ours does not."""
    if ours.name != planner.name:
        yield Level.NOTE, f"has the code of {ours.name}, whatever it is called"
    for field in ("privileged", "native_protocol", "miniature", "published_as"):
        said, known = getattr(planner, field), getattr(ours, field)
        if said != known:
            yield (
                Level.ERROR,
                f"says {field.replace('_', ' ')}: {said}, and {ours.name}, whose code it has, is {known}; submit what "
                "eval wrote",
            )
    if _OWN_WEIGHTS in planner.settings:
        yield Level.NOTE, f"ran {ours.name} with weights of its own, of which only the hash is known"
    elif planner.weights_sha256 != ours.weights_sha256:
        yield (
            Level.ERROR,
            f"names other weights ({_short(planner.weights_sha256)}) than {ours.name} has "
            f"({_short(ours.weights_sha256)}); with your own weights the record says so (eval --checkpoint)",
        )


def _declared(planner: PlannerFacts, ours: PlannerFacts | None) -> str:
    called = "" if ours is None else f"is called {ours.name} and has not this version's code of it; "
    native = planner.native_protocol or "none"
    return (
        f"{called}declares privileged: {'yes' if planner.privileged else 'no'}, its own protocol: {native}, weights: "
        f"{_short(planner.weights_sha256)}, code: {_short(planner.code_sha256)}; nothing here can show it"
    )


def _short(sha256: str | None) -> str:
    return "none" if sha256 is None else sha256[:12]
