"""What a record says of itself, run or drives, beside its own rows and the data set."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from benchmark.datasets.judged import stored_realism
from benchmark.datasets.scene_facts import frozen_split_of
from benchmark.extensions.submissions.findings import Level, Said
from benchmark.records.run_schema import RecordFacts, RunFacts, SceneFacts
from benchmark.records.seed_splits import generated_facts
from benchmark.report.words import counted
from benchmark.untrusted.files import one_line

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


def claims_of(facts: RecordFacts, failed: int, units: int, unit: str, data_name: str) -> Iterator[Said]:
    """Findings that need no data set.

    Args:
        failed: Rows that have no plan, or whose drive failed.
        units: Rows.
    """
    if facts.data.name != data_name:
        yield (
            Level.ERROR,
            f"is of the data set {one_line(facts.data.name, 80)}, not {data_name}; open that one with --data",
        )
    if failed:
        yield Level.ERROR, f"has no plan for {failed} of {counted(units, unit)}; the errors are in its rows"
    if (facts.status == "complete") != (failed == 0):
        yield Level.ERROR, f"says that it is {facts.status}, and {failed} of {counted(units, unit)} failed"


def split_findings(facts: RecordFacts, data: "DataSet") -> Iterator[Said]:
    """Check that a record ran on the split that the data set has, and describes the data set as it describes itself."""
    scenes = list(data.scene_names(facts.split))
    if sorted(facts.scenes) != sorted(scenes):
        yield (
            Level.ERROR,
            f"ran on {len(set(facts.scenes) & set(scenes))} of {counted(len(scenes), 'scene')} of {facts.split}; "
            "run it without --scenes and --limit",
        )
    if facts.scenes_in_split != len(scenes):
        yield (
            Level.ERROR,
            f"says that {facts.split} has {counted(facts.scenes_in_split, 'scene')}, {data.root} has {len(scenes)}",
        )
    if others := _other_facts(facts, data.scene_facts(facts.scenes)):
        yield Level.ERROR, f"says of {others[0]} what the data set does not say; run challenger-bench rescore"
    provenance = data.provenance()
    pairs: list[tuple[str, object, object]] = [
        ("frozen split", facts.frozen_split, frozen_split_of(provenance)),
        ("search", facts.generated, generated_facts(provenance)),
    ]
    realism = stored_realism(data.root, data.version)
    if isinstance(facts, RunFacts) and realism is not None:
        pairs.append(("realism", facts.realism, realism))
    for name, said, here in pairs:
        # Older records say nothing.
        if said is not None and said != here:
            yield Level.ERROR, f"says of the scenes' {name} what {data.root} does not say; run it again"


_COUNTED_ELSEWHERE: Final = ("judgement", "truth")


def _other_facts(facts: RecordFacts, found: Mapping[str, SceneFacts]) -> Sequence[str]:
    """Scenes of which a record says something else than the data set; what either does not say is no fault."""

    def other(said: SceneFacts, here: SceneFacts) -> bool:
        # Scenes need not be judged, and their truth is counted where the plans are judged anew.
        asked = ((name, value) for name, value in said if name not in _COUNTED_ELSEWHERE or getattr(here, name))
        return any(value is not None and value != getattr(here, name) for name, value in asked)

    return [name for name, said in facts.scene_facts.items() if name in found and other(said, found[name])]
