"""What records say of truth that their data set does not have: labels, sizes, categories, complete samples, poses."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from benchmark.datasets.annotation_counts import AnnotationCount
from benchmark.records.caveats import Caveat
from benchmark.records.rows import Rows
from benchmark.records.run_schema import SceneFacts, TruthFacts
from benchmark.report.words import counted

_NAMED: Final = 3
_DRIVES: Final = "drives there are in no rate of contacts and in no score that counts them"


def run_truth(scenes: Mapping[str, SceneFacts], rows: Rows) -> Iterator[Caveat]:
    """Caveats of a run record about the truth of its scenes."""
    known = _known(scenes)
    yield from _labels(known, "collision rates and counts of failed scenes leave them out")
    partly = [name for name, truth in known.items() if truth.annotations and truth.unlabelled]
    if partly:
        of = counted(sum(len(rows.columns.places_of_scenes[name]) for name in partly), "sample")
        unlabelled = sum(known[name].unlabelled for name in partly)
        yield Caveat(
            kind="truth",
            sentence=f"{_scenes(partly, len(scenes))} annotations in a part only: {unlabelled} of {of} there are in no "
            "collision rate",
        )
    complete = rows.columns.flags("complete")
    short = [name for name, places in rows.columns.places_of_scenes.items() if not complete[places].any()]
    if short:
        yield Caveat(
            kind="truth",
            sentence=f"{_scenes(short, len(scenes))} no sample with a recording of 3 s ahead: only protocols that "
            "count incomplete samples have a rate there",
        )
    yield from _boxes(known)
    yield from _categories(known, "protocols that go by categories say nothing of contacts")
    yield from _poses(known, len(scenes))


def drive_truth(scenes: Mapping[str, SceneFacts]) -> Iterator[Caveat]:
    """Caveats of a record of drives; arguments as of `run_truth`."""
    known = _known(scenes)
    yield from _labels(known, _DRIVES)
    partly = [name for name, truth in known.items() if truth.annotations and truth.unlabelled]
    if partly:
        yield Caveat(
            kind="truth",
            sentence=f"{_scenes(partly, len(known))} annotations in a part only: {_DRIVES}",
        )
    yield from _boxes(known)
    yield from _categories(known, "who is at fault, and scores that ask who moves by itself, may be wrong")
    yield from _poses(known, len(scenes))


def _known(scenes: Mapping[str, SceneFacts]) -> dict[str, TruthFacts]:
    return {name: facts.truth for name, facts in scenes.items() if facts.truth is not None}


def _labels(known: Mapping[str, TruthFacts], so: str) -> Iterator[Caveat]:
    none = [name for name, truth in known.items() if not truth.annotations]
    if none:
        yield Caveat(kind="truth", sentence=f"{_scenes(none, len(known))} no annotations: {so}")


def _boxes(known: Mapping[str, TruthFacts]) -> Iterator[Caveat]:
    without = {name: truth.without_size for name, truth in known.items() if truth.without_size}
    if without:
        yield Caveat(
            kind="boxes",
            sentence=f"{counted(sum(without.values()), 'annotation')} of {_names([*without])} without length, width or "
            "height: nothing can touch them",
        )


def _categories(known: Mapping[str, TruthFacts], so: str) -> Iterator[Caveat]:
    found = AnnotationCount.together([AnnotationCount(truth.annotations, truth.unknown) for truth in known.values()])
    if found.unknown:
        few = "protocols that go by categories do not see them"
        then = f"{so}; say what they mean with --categories" if found.foreign else few
        yield Caveat(kind="categories", sentence=f"{found.sentence}: {then}")


def _poses(known: Mapping[str, TruthFacts], scenes: int) -> Iterator[Caveat]:
    still = [name for name, truth in known.items() if truth.motionless]
    if still:
        yield Caveat(
            kind="pose",
            sentence=f"{_scenes(still, scenes)} the same ego pose at every sample, as if there were none: L2 and "
            "verdicts there are those of a car that stands",
        )


def _scenes(names: Sequence[str], among: int) -> str:
    return f"{len(names)} of {counted(among, 'scene')} ({_names(names)}) {'has' if len(names) == 1 else 'have'}"


def _names(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")
