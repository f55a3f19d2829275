"""What a data set says of how a scene was made."""

from collections.abc import Mapping
from typing import Any


def reported(provenance: Mapping[str, Any] | None, scene: str, name: str, otherwise: object = None) -> object:
    """One part of the report of a scene in ``challenger.json``, unchecked.

    Args:
        otherwise: Value where nothing is said.
    """
    made = (provenance or {}).get("scenes", {}).get(scene, {})
    report = made.get("report") if isinstance(made, Mapping) else None
    return report.get(name, otherwise) if isinstance(report, Mapping) else otherwise
