"""Which judges go by categories that a data set does not have: what they would say of it means nothing."""

from collections.abc import Iterable, Sequence

from benchmark.datasets.annotation_counts import AnnotationCount
from benchmark.errors import InputError
from benchmark.pdm.definition import PDM
from benchmark.protocols import using_categories


def unjudged(counts: AnnotationCount, protocols: Sequence[str]) -> tuple[str, ...]:
    """Judges that cannot judge contacts here, since too many categories are unknown.

    These are ``pdm`` and those of the protocols that go by categories; without unknown ones there are none.
    """
    return (*using_categories(protocols), PDM) if counts.foreign else ()


def require_vocabulary(counts: AnnotationCount, asked: Iterable[str], protocols: Sequence[str], where: str) -> None:
    """Refuse judges that were asked for by name, or are the planner's own, and say nothing of contacts."""
    silent = unjudged(counts, protocols)
    wrong = next((name for name in asked if name in silent), None)
    if wrong is not None:
        raise InputError(
            f"{counts.sentence} in {where}, so that {wrong}, which goes by categories, sees almost nobody; say what "
            "they mean with --categories (short, lyft, t4, argoverse2 or a JSON file)"
        )
