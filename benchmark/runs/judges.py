"""What a record says of the data that it is about: which judge fills which field, in one table."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.datasets.judged import stored_realism
from benchmark.datasets.scene_facts import frozen_split_of
from benchmark.fairness.kept_judgements import judged_facts
from benchmark.machine.environment import facts as environment_facts
from benchmark.machine.workers import Executor, LocalProcesses
from benchmark.records.seed_splits import generated_facts

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True, slots=True)
class JudgedScenes:
    """Scenes of a data set that are judged.

    Attributes:
        kept: Folder of runs, where judgements of encounters are kept and found again; ``None`` asks for none.
        executor: Where those are judged that are not kept; nothing depends on it.
    """

    data: "DataSet"
    split: str
    scenes: tuple[str, ...]
    kept: Path | None = None
    executor: Executor = field(default_factory=LocalProcesses)


def _scene_facts(of: JudgedScenes) -> Any:
    """Facts of the scenes, with whether an encounter could have been survived where judgements are kept."""
    if of.kept is None:
        return of.data.scene_facts(of.scenes)
    return judged_facts(of.data, of.scenes, of.kept, of.executor)


JUDGES: Final[Mapping[str, Callable[[JudgedScenes], Any]]] = {
    "scene_facts": _scene_facts,
    "realism": lambda of: stored_realism(of.data.root, of.data.version),
    "frozen_split": lambda of: frozen_split_of(of.data.provenance()),
    "review": lambda of: of.data.review(of.split).facts,
    "generated": lambda of: generated_facts(of.data.provenance()),
}
"""By field of a record: fairness, realism, provenance and review."""


def described(of: JudgedScenes, *fields: str) -> dict[str, Any]:
    """Fields of a record about its data and the machine, those named of `JUDGES` or all."""
    data = of.data
    return {
        "data": {"name": data.name, "version": data.version, "fingerprint": data.fingerprint()},
        "split": of.split,
        "scenes": list(of.scenes),
        "scenes_in_split": len(data.scene_names(of.split)),
        **{field: JUDGES[field](of) for field in fields or JUDGES},
        "environment": environment_facts(),
    }
