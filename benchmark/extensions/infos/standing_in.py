"""The folder that official code is pointed at in place of a root: links to it, and the maps that it lacks.

The root itself stays as it is: its content is what run records know it by, and official code writes into the folder
that it is given.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.datasets.map_layers import empty_expansion, expansion_file
from benchmark.errors import InputError
from benchmark.machine.storage import write_json, writing_to

FOLDER: Final = "nuscenes"
"""What official code calls the folder below its ``data``."""
_LINKED: Final = ("samples", "sweeps", "can_bus")
_MAPS: Final = "maps/expansion"


def missing_cities(root: Path) -> list[str]:
    """Cities that official code opens the maps of and a root has none of."""
    return [city for city in OFFICIAL_LOCATIONS if expansion_file(root, city) is None]


@dataclass(frozen=True, slots=True)
class StandIn:
    """The folder before it is written: its links with their targets, and its empty maps."""

    folder: Path
    links: Mapping[Path, Path]
    maps: Sequence[Path]

    @classmethod
    def of(cls, root: Path, to: Path, version: str, *, root_as: str | None, beside: Sequence[str]) -> Self:
        """The folder that is to be written; refused where something else has one of its names.

        Args:
            root_as: Where links lead to, if not to the root where it is here.
            beside: Files of the export that official code looks for in the folder.
        """
        folder = to / FOLDER
        source = root.resolve() if root_as is None else Path(root_as)
        parts = [name for name in (version, *_LINKED) if (root / name).exists()]
        parts += [f"maps/{path.name}" for path in sorted((root / "maps").glob("*")) if path.name != "expansion"]
        parts += [f"{_MAPS}/{path.name}" for path in sorted((root / _MAPS).glob("*.json"))]
        links = {folder / part: source / part for part in parts} | {folder / name: Path("..") / name for name in beside}
        found = cls(folder, links, [folder / _MAPS / f"{city}.json" for city in missing_cities(root)])
        found._require_free()
        return found

    def write(self) -> None:
        """Write it; raises `InputError` if the disk refuses."""
        for path, target in self.links.items():
            with writing_to(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)
                path.symlink_to(target)
        for path in self.maps:
            write_json(path, empty_expansion(), indent=None)

    def _require_free(self) -> None:
        """Maps are plain files where a former export had none to link to."""
        if self.folder.is_symlink():
            raise InputError(f"{self.folder} is a link, and what it leads to must stay as it is; choose another --to")
        for path, target in self.links.items():
            if path.is_symlink() and path.readlink() != target:
                raise InputError(
                    f"{path} leads to {path.readlink()}, for {self.folder.parent} was exported from another root; "
                    "choose another --to"
                )
            taken = path.exists() and not path.is_symlink()
            if taken and not (path.is_file() and path.parent == self.folder / _MAPS):
                raise InputError(f"{path} is in the way of a link; choose another --to, or remove it")
