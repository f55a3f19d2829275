"""Settings of the search that a generated root comes from, as far as it says them."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmark.machine.storage import read_cached_json
from generation.search.presets import PRESETS, build_hyper_parameters
from generation.splits.packaged import list_packaged_splits, read_frozen_split


def read_recorded_settings(root: Path, made: Mapping[str, Any] | None) -> dict[str, Any]:
    """Settings of the search behind a root; ``made`` is the content of its ``challenger.json``.

    Those in ``search.json`` of a root that was searched. A frozen split says the hash of its settings alone: for a
    packaged one, those of the default or of a preset that have this hash. Empty where neither is known.
    """
    recorded = read_cached_json(root / "search.json")
    if isinstance(recorded, dict) and isinstance(recorded.get("hyper"), dict):
        return {name: value for name, value in recorded["hyper"].items() if isinstance(value, bool | int | float | str)}
    frozen = made.get("frozen") if made is not None else None
    name = frozen.get("name") if isinstance(frozen, dict) else None
    if name not in list_packaged_splits():
        return {}
    search = read_frozen_split(str(name)).frozen.search
    known = [build_hyper_parameters(preset) for preset in PRESETS]
    return next((asdict(hyper) for hyper in known if hyper.fingerprint == search.hyper), {})
