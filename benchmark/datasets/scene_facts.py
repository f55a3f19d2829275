"""Where a scene comes from and what is done in it, from ``challenger.json`` or from the scene's name."""

import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

from benchmark.records.run_schema import SceneFacts

_PUBLISHED: Final = re.compile(r"(scene-\d{4})-.+")
"""Names of the published Adv-nuSc, which has no provenance file: the recorded scene and a suffix."""


def scene_facts_of(name: str, made: Mapping[str, Any]) -> SceneFacts:
    """Facts of one scene.

    Args:
        name: Scene name.
        made: What ``challenger.json`` says of the scene; empty where it says nothing.

    Returns:
        Source: as the file says, else the ``scene-0001`` of ``scene-0001-suffix``, else the scene itself. Manoeuvre:
        the primary one of the first adversary that has labels.
    """
    published = _PUBLISHED.fullmatch(name)
    manoeuvres = (found.get("manoeuvre") for found in labels_in(made.get("report")) if isinstance(found, dict))
    return SceneFacts(
        source=made.get("source_scene") or (published[1] if published else name),
        manoeuvre=next((manoeuvre for manoeuvre in manoeuvres if isinstance(manoeuvre, str)), None),
    )


def labels_in(report: Any) -> Iterator[Any]:
    """Labels in a report, which has one for each adversary, wherever it puts them.

    Args:
        report: Any JSON value.

    Yields:
        What stands under the key ``labels``, in the order of the keys and lists.
    """
    if isinstance(report, list):
        for item in report:
            yield from labels_in(item)
    elif isinstance(report, dict):
        for key in sorted(report):
            if key == "labels" and report[key] is not None:
                yield report[key]
            else:
                yield from labels_in(report[key])
