"""Verdicts of inspectors beside a data set: which stand on a split, and how more are recorded."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from benchmark.datasets.scene_names import read_names
from benchmark.datasets.stored_rows import iterate_rows
from benchmark.datasets.tables import find_variant_folders, find_version
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.storage import lock_folder, write_json
from benchmark.records.review import (
    REJECTED,
    REVIEW_FILE,
    SCHEMA,
    ReviewFile,
    SplitReview,
    StandingVerdict,
    Verdict,
    read_review,
    resolve_verdicts,
)
from benchmark.report.words import pluralise
from benchmark.untrusted.files import to_one_line

LEFT_OUT: Final = "left_out"
"""In ``challenger.json``: scenes that a build left out because they were rejected."""


def read_left_out(made: Any, split: str | None) -> dict[str, StandingVerdict]:
    """Verdicts on scenes that the build of a split left out because they were rejected, by name.

    ``made`` is unchecked ``challenger.json``: a value that is no verdict names no scene. A build says it of its own
    split alone.
    """
    entries = made.get(LEFT_OUT) if isinstance(made, dict) and split in (None, made.get("split")) else None
    rejected = {}
    for name, entry in entries.items() if isinstance(entries, dict) else ():
        if isinstance(entry, dict) and isinstance(entry.get("token"), str):
            rejected[name] = StandingVerdict(
                name, entry["token"], REJECTED, to_one_line(entry.get("reason", "")), left_out=True
            )
    return rejected


def read_root_review(
    root: Path, tokens: Mapping[str, str], made: Any, split: str | None, verdicts: Mapping[str, Verdict] | None = None
) -> SplitReview:
    """Review of a split of one root; ``tokens`` are those of its scenes by name, ``made`` is ``challenger.json``.

    ``verdicts`` are those beside the root, if they were read before.
    """
    given = read_review(root) if verdicts is None else verdicts
    return resolve_verdicts(given, tokens, read_left_out(made, split))


def join_reviews(
    parts: Mapping[str, SplitReview], outer: Mapping[str, Verdict], tokens: Mapping[str, str]
) -> SplitReview:
    """Review of roots side by side, which may have verdicts each and all together: what either rejects is rejected.

    ``parts`` are by folder; ``outer`` verdicts and ``tokens`` by prefixed name.
    """
    renamed_parts = [part.under(folder) for folder, part in parts.items()]
    judged = {verdict.name: verdict for part in renamed_parts for verdict in part.judged}
    above = resolve_verdicts(outer, tokens)
    for verdict in above.judged:
        if verdict.name not in judged or verdict.verdict == REJECTED:
            judged[verdict.name] = verdict
    outdated = {*above.outdated, *(name for part in renamed_parts for name in part.outdated)}
    waiting = tuple(name for name in tokens if name not in judged)
    return SplitReview(tuple(judged[name] for name in sorted(judged)), waiting, tuple(sorted(outdated)))


def scene_tokens(root: Path, version: str | None = None) -> dict[str, str]:
    """Tokens of all scenes of a data set, by name.

    Args:
        root: A nuScenes-format root, or a folder of variant roots.
        version: Version folder; needed only where there are several.

    Returns:
        Tokens, sorted by name within each root.

    Raises:
        InputError: If there is no such data set, or its list of scenes is broken.
    """
    folders = find_variant_folders(root)
    if folders:
        parts = {folder: scene_tokens(root / folder, version) for folder in folders}
        return {f"{folder}/{name}": token for folder, part in parts.items() for name, token in part.items()}
    folder = root / find_version(root, version)
    rows, names = iterate_rows(folder / "scene.json", "name", "token"), read_names(folder)
    return dict(sorted((names.get(row["name"], row["name"]), row["token"]) for row in rows))


def record_verdicts(root: Path, verdicts: Mapping[str, Verdict | None]) -> None:
    """Add verdicts to the file beside a data set; those that are there on other scenes stay.

    Args:
        root: Root of the data set.
        verdicts: By name of the scene; ``None`` takes the one that is there back.

    Raises:
        InputError: If the file is damaged or cannot be written, or another command is writing there.
    """
    with lock_folder(root):
        merged = {**read_review(root), **verdicts}
        stored = ReviewFile(
            schema=SCHEMA, verdicts={name: verdict for name, verdict in merged.items() if verdict is not None}
        )
        write_json(root / REVIEW_FILE, stored.model_dump(mode="json", by_alias=True))


def require_scenes(names: Mapping[str, Any], tokens: Mapping[str, str], path: Path, root: Path) -> None:
    """Raise `InputError` if a file of verdicts names a scene that a data set does not have."""
    unknown = sorted(set(names) - set(tokens))
    if unknown:
        raise InputError(
            f"{path} names {to_one_line(unknown[0], 80)}, which is not a scene of {root}; "
            f"{did_you_mean(unknown[0], list(tokens))}it has {pluralise(len(tokens), 'scene')}; nothing was recorded"
        )
