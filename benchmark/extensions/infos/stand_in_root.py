"""The folder that official code is pointed at in place of a root: links to it, and the maps that it lacks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.datasets.map_layers import find_expansion_file, make_empty_expansion
from benchmark.errors import InputError
from benchmark.machine.storage import write_json, writing_to

FOLDER: Final = "nuscenes"
"""Name that official code gives to the folder below its ``data``."""
_LINKED: Final = ("samples", "sweeps", "can_bus")
_MAPS: Final = "maps/expansion"


def find_missing_cities(root: Path) -> list[str]:
    """Cities that official code opens the maps of and a root has none of."""
    return [city for city in OFFICIAL_LOCATIONS if find_expansion_file(root, city) is None]


@dataclass(frozen=True, slots=True)
class StandInRoot:
    """The folder before it is written: its links with their targets, and its empty maps."""

    folder: Path
    links: Mapping[Path, Path]
    maps: Sequence[Path]

    @classmethod
    def of(cls, root: Path, to: Path, version: str, *, root_as: str | None, beside: Sequence[str]) -> Self:
        """Folder that is to be written; refused where something else has one of its names.

        Links lead to ``root_as``, if not to the root as it is here; official code looks for the files ``beside`` in it.
        """
        folder = to / FOLDER
        source = root.resolve() if root_as is None else Path(root_as)
        parts = [name for name in (version, *_LINKED) if (root / name).exists()]
        parts += [f"maps/{path.name}" for path in sorted((root / "maps").glob("*")) if path.name != "expansion"]
        parts += [f"{_MAPS}/{path.name}" for path in sorted((root / _MAPS).glob("*.json"))]
        links = {folder / part: source / part for part in parts} | {folder / name: Path("..") / name for name in beside}
        stand_in = cls(folder, links, [folder / _MAPS / f"{city}.json" for city in find_missing_cities(root)])
        stand_in._require_free()
        return stand_in

    def write(self) -> None:
        """Write it; raises `InputError` if the disk refuses."""
        for path, target in self.links.items():
            with writing_to(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)
                path.symlink_to(target)
        for path in self.maps:
            write_json(path, make_empty_expansion(), indent=None)

    def _require_free(self) -> None:
        """Maps are plain files where a former export had none to link to."""
        if self.folder.is_symlink():
            raise InputError(f"{self.folder} is a link, whose target must not be changed; choose another --to")
        for path, target in self.links.items():
            if path.is_symlink() and path.readlink() != target:
                raise InputError(
                    f"{path} links to {path.readlink()}, for {self.folder.parent} was exported from another root; "
                    "choose another --to"
                )
            occupied = path.exists() and not path.is_symlink()
            if occupied and not (path.is_file() and path.parent == self.folder / _MAPS):
                raise InputError(f"{path} exists where a link must go; choose another --to, or remove it")
