"""How much of the truth of scenes their tables hold, known before any scene is read."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol

from benchmark.errors import InputError
from benchmark.report.words import counted

MOST_UNKNOWN: Final = 0.01
"""Share of annotations with unknown categories above which nothing is said that goes by categories."""
_NAMED: Final = 3


@dataclass(frozen=True, slots=True)
class AnnotationCount:
    """Annotations of one scene or several; ``unknown`` are those of categories that nuScenes does not have."""

    annotations: int
    unknown: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def together(cls, counts: Sequence["AnnotationCount"]) -> "AnnotationCount":
        """The counts of several scenes."""
        unknown: Counter[str] = Counter()
        for each in counts:
            unknown.update(each.unknown)
        return cls(sum(each.annotations for each in counts), unknown)

    @property
    def foreign(self) -> bool:
        """Whether so many categories are unknown that what goes by them means nothing."""
        return sum(self.unknown.values()) > MOST_UNKNOWN * self.annotations

    @property
    def sentence(self) -> str:
        """Sentence on the number of annotations of unknown categories, with their names; no full stop at its end."""
        names = sorted(self.unknown, key=lambda name: (-self.unknown[name], name))
        shown = ", ".join(map(repr, names[:_NAMED])) + (", ..." if len(names) > _NAMED else "")
        return (
            f"{sum(self.unknown.values()):,} of {counted(self.annotations, 'annotation')} have unknown categories "
            f"({shown})"
        )


class CountedData(Protocol):
    """The part of a data set that counts its annotations."""

    root: Path

    def annotation_counts(self, names: Sequence[str]) -> dict[str, AnnotationCount]:
        """Counts by scene name."""


def require_annotated(data: CountedData, split: str, scenes: Sequence[str]) -> AnnotationCount:
    """Refuse scenes none of which has an annotation: there is no truth to judge anything by."""
    found = AnnotationCount.together(list(data.annotation_counts(scenes).values()))
    if not found.annotations:
        which = "none of them" if len(scenes) > 1 else "it"
        raise InputError(
            f"{counted(len(scenes), 'scene')} of split {split!r} of {data.root} cannot be judged: {which} has "
            f"{'an' if len(scenes) > 1 else 'no'} annotation; choose scenes that are labelled (test splits are not)"
        )
    return found
