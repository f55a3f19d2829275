"""Which judges go by categories that a data set does not have: what they would say of it means nothing."""

from collections.abc import Iterable, Sequence

from benchmark.datasets.annotation_counts import AnnotationCount
from benchmark.errors import InputError
from benchmark.pdm.definition import PDM
from benchmark.protocols import using_categories


def unjudged(counts: AnnotationCount, protocols: Sequence[str]) -> tuple[str, ...]:
    """Judges that say nothing of contacts.

    Args:
        counts: Annotations of the scenes that are judged.
        protocols: Who judges.

    Returns:
        Those of the protocols that go by categories, and ``pdm``, if too many categories are unknown; else none.
    """
    return (*using_categories(protocols), PDM) if counts.foreign else ()


def require_vocabulary(counts: AnnotationCount, asked: Iterable[str], protocols: Sequence[str], where: str) -> None:
    """Refuse judges that were asked for and that say nothing of contacts.

    Args:
        counts: Annotations of the scenes that are judged.
        asked: Judges that were named, or that are the planner's own.
        protocols: Who judges.
        where: The data set.

    Raises:
        InputError: If there is one.
    """
    silent = unjudged(counts, protocols)
    wrong = next((name for name in asked if name in silent), None)
    if wrong is not None:
        raise InputError(
            f"{counts.sentence} in {where}, so that {wrong}, which goes by categories, sees almost nobody; say what "
            "they mean with --categories (short, lyft, t4, argoverse2 or a JSON file)"
        )
