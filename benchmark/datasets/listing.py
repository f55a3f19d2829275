"""Which scenes and splits a data set has, from its small files alone, without the devkit and the large tables."""

from pathlib import Path

from benchmark.datasets.reviewed import joined, review_of_rows, scene_tokens
from benchmark.datasets.split_names import read_splits, scenes_of_split
from benchmark.datasets.tables import find_version, variant_folders
from benchmark.machine.storage import read_kept_json
from benchmark.records.review import SplitReview, read_review


def listed_scenes(root: Path, split: str | None = None, *, version: str | None = None) -> tuple[str, ...]:
    """Names of scenes as an opened data set has them (`benchmark.datasets.nuscenes.NuScenesData.scene_names`).

    Args:
        split: A split, or ``None`` for all scenes.
        version: Version folder; needed only where there are several.
    """
    if split is not None:
        review = listed_review(root, split, version=version)
        return review.kept(tuple(name for name in scene_tokens(root, version) if name in set(review.named)))
    return tuple(scene_tokens(root, version))


def listed_review(root: Path, split: str, *, version: str | None = None) -> SplitReview:
    """Review of a split (`benchmark.datasets.nuscenes.NuScenesData.review`)."""
    variants = variant_folders(root)
    if not variants:
        return _review(root, split, version)
    parts = {folder: _review(root / folder, split, version) for folder in variants}
    of_split = {name for folder, part in parts.items() for name in part.under(folder).named}
    tokens = {name: token for name, token in scene_tokens(root, version).items() if name in of_split}
    return joined(parts, read_review(root), tokens)


def _review(root: Path, split: str, version: str | None) -> SplitReview:
    version, tokens = find_version(root, version), scene_tokens(root, version)
    said = read_kept_json(root / version / "challenger.json")
    built_as = said.get("split") if isinstance(said, dict) else None
    names = scenes_of_split(split, tuple(tokens), read_splits(root, version), where=str(root), built_as=built_as)
    return review_of_rows(root, {name: tokens[name] for name in names}, said, split)
