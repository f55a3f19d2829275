"""What ``challenger-bench weights list`` says: which official files there are, and what has been imported."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adapters.checkpoints.cache import Provenance, cached_weights
from adapters.checkpoints.official import OFFICIAL_FILES, OfficialFile


@dataclass(frozen=True, slots=True)
class KnownWeights:
    """One model's weights.

    Attributes:
        official: The published file.
        imported: What has been imported for the model, from this file or another.
    """

    official: OfficialFile
    imported: dict[Path, Provenance]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        official = self.official
        return {
            "model": official.model,
            "file": official.name,
            "page": official.page,
            "url": official.url,
            "licence": official.licence,
            "size_bytes": official.size_bytes,
            "sha256": official.sha256,
            "with": [{"file": file.name, "page": file.page, "url": file.url} for file in official.companions],
            "imported": [
                {"path": str(path), **provenance.model_dump(mode="json")} for path, provenance in self.imported.items()
            ],
        }

    def plain(self) -> str:
        """A few lines of text."""
        official = self.official
        size = "size unknown" if official.size_bytes is None else f"{official.size_bytes / 1e6:.0f} MB"
        digest = "SHA-256 unknown" if official.sha256 is None else f"SHA-256 {official.sha256}"
        lines = [f"{official.model}: {official.name}, {size}, {digest}", f"  {official.page}", f"  {official.licence}"]
        lines += [f"  needs {file.name}: {file.page}" for file in official.companions]
        lines += [
            f"  imported from {found.source} ({found.source_sha256[:16]}), {found.normalisation}: {path}"
            for path, found in self.imported.items()
        ]
        return "\n".join(lines if self.imported else [*lines, "  not imported"])


def known_weights(cache: Path) -> tuple[KnownWeights, ...]:
    """Official files and what has been imported for their models.

    Args:
        cache: Folder of weights.

    Returns:
        One entry an official file.
    """
    return tuple(KnownWeights(file, cached_weights(cache, file.model)) for file in OFFICIAL_FILES)
