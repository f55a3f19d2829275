"""Images that are drawn when they are looked at: of a root whose ``challenger.json`` says who draws them.

They follow from what its tables name, so they are no part of its fingerprint, and which of them are there is no fault.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.machine.extension import import_reference
from benchmark.planning import CameraView
from benchmark.untrusted.http_images import read_picture

DRAWN_BY: Final = "drawn_by"
"""In ``challenger.json``: one of the artists."""
_ARTISTS: Final[Mapping[str, str]] = {"town": "generation.sources.mini:draw_town_scene"}


@dataclass(frozen=True, slots=True)
class Artist:
    """Draws the missing images of one root."""

    root: Path
    reference: str

    @classmethod
    def of(cls, root: Path, provenance: object) -> Self | None:
        """The artist of a root, or ``None`` where all images that there will be are there."""
        name = provenance.get(DRAWN_BY) if isinstance(provenance, Mapping) else None
        reference = _ARTISTS.get(name) if isinstance(name, str) else None
        return None if reference is None else cls(root, reference)

    def draw(self, scene: str, paths: Iterable[Path], *, sweeps: bool) -> None:
        """Draw a scene's images of samples, or all, if one of those named is missing."""
        if not all(path.is_file() for path in paths):
            import_reference(self.reference)(self.root, scene, sweeps=sweeps)

    def show(self, scene: str, view: CameraView) -> CameraView:
        """The same view, whose scene is drawn when it is loaded."""
        return replace(view, load=partial(_draw_and_read, self, scene, view.path))


def _draw_and_read(artist: Artist, scene: str, path: Path) -> NDArray[np.uint8]:
    artist.draw(scene, (path,), sweeps=False)
    return read_picture(path)
