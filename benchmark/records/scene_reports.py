"""What a data set says of how a scene was made."""

from collections.abc import Mapping
from typing import Any


def reported(provenance: Mapping[str, Any] | None, scene: str, name: str, otherwise: object = None) -> object:
    """One part of the report of a scene.

    Args:
        provenance: What a data set says of how it was made (``challenger.json``), if it does.
        scene: Name of the scene.
        name: Name of the part.
        otherwise: What to take where nothing is said.

    Returns:
        What is said, whatever it is.
    """
    made = (provenance or {}).get("scenes", {}).get(scene, {})
    report = made.get("report") if isinstance(made, Mapping) else None
    return report.get(name, otherwise) if isinstance(report, Mapping) else otherwise
