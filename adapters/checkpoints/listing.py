"""What ``challenger-bench weights list`` says: which published weights there are, and which of them are here."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adapters.checkpoints.cache import Provenance, cached_weights, weights_folder
from benchmark.report.terminal import wrapped
from benchmark.weights.catalogue import CHECKPOINTS, FOLDERS, PublishedWeights
from benchmark.weights.folders import kept_folder


@dataclass(frozen=True, slots=True)
class KnownWeights:
    """Published weights. `imported` is what has been imported for a model, from its file or another, or the folder."""

    weights: PublishedWeights
    imported: dict[Path, Provenance | None]

    def as_json(self) -> dict[str, Any]:
        """Plain values; what checkpoints and folders both have has the same name."""
        known = self.weights
        here = [
            {"path": str(path), **({} if found is None else found.model_dump(mode="json"))}
            for path, found in self.imported.items()
        ]
        if not known.is_folder:
            checkpoint, *companions = known.files
            return {
                "model": known.name,
                "file": checkpoint.name,
                "page": checkpoint.page,
                "url": checkpoint.url,
                "licence": known.licence,
                "size_bytes": checkpoint.size_bytes,
                "sha256": checkpoint.sha256,
                "with": [{"file": file.name, "page": file.page, "url": file.url} for file in companions],
                "imported": here,
            }
        return {
            "model": known.name,
            "repository": known.repository,
            "revision": known.revision,
            "page": known.address,
            "licence": known.licence,
            "used_by": known.used_by,
            "size": known.size_text,
            "files": [
                {"name": file.name, "url": known.url(file), "size_bytes": file.size_bytes, "sha256": file.sha256}
                for file in known.files
            ],
            "imported": here,
        }

    def plain(self) -> str:
        """A few lines of text."""
        known = self.weights
        if known.is_folder:
            head = f"{known.name}: {known.repository} at {known.revision}, {known.size_text}, for {known.used_by}"
            lines = [head, f"  {known.address}", f"  {known.licence}", *(f"  in {path}" for path in self.imported)]
        else:
            checkpoint, *companions = known.files
            size = "size unknown" if checkpoint.size_bytes is None else f"{checkpoint.size_bytes / 1e6:.0f} MB"
            digest = "SHA-256 unknown" if checkpoint.sha256 is None else f"SHA-256 {checkpoint.sha256}"
            lines = [f"{known.name}: {checkpoint.name}, {size}, {digest}", f"  {checkpoint.page}", f"  {known.licence}"]
            lines += [f"  needs {file.name}: {file.page}" for file in companions]
            lines += [
                f"  imported from {found.source} ({found.source_sha256[:16]}), {found.normalisation}: {path}"
                for path, found in self.imported.items()
                if found is not None
            ]
        every = lines if self.imported else [*lines, "  not imported"]
        return "\n".join(line for text in every for line in _wrapped(text))


def known_weights(
    cache: Path | None = None, entries: Sequence[PublishedWeights] = (*CHECKPOINTS, *FOLDERS)
) -> tuple[KnownWeights, ...]:
    """Published weights and what is here of them.

    Args:
        cache: Folder of weights; the user's by default.
        entries: Those to look for.

    Returns:
        One for each entry.
    """
    return tuple(KnownWeights(entry, _imported(entry, cache or weights_folder())) for entry in entries)


def _wrapped(text: str) -> list[str]:
    indent = text[: len(text) - len(text.lstrip())]
    return wrapped(text.strip(), indent=indent, hanging="  ")


def _imported(weights: PublishedWeights, cache: Path) -> dict[Path, Provenance | None]:
    if not weights.is_folder:
        return dict(cached_weights(cache, weights.name))
    folder = kept_folder(weights, cache)
    return {} if folder is None else {folder: None}
