"""The repositories that read info files: how these are called there, and which scenes their converters put where."""

from dataclasses import dataclass
from typing import Final, Literal

from benchmark.datasets.devkit_import import import_devkit_module
from benchmark.errors import InputError

RepositoryName = Literal["uniad", "vad", "sparsedrive"]
Part = Literal["train", "val", "test"]

MINI: Final = "v1.0-mini"
TRAINVAL: Final = "v1.0-trainval"
TEST: Final = "v1.0-test"
VERSIONS: Final = (MINI, TRAINVAL, TEST)
"""Version folders that the converters and readers know."""


@dataclass(frozen=True, slots=True)
class Repository:
    """One repository; its info files begin with `stem`, those of v1.0-mini lie in `mini_folder`, if not beside others.

    `has_can_bus` is whether infos hold prev, next, frame_idx and can_bus; `image_size` is width and height that its
    image pipeline takes for granted, ``None`` where it follows the images.
    """

    name: RepositoryName
    title: str
    stem: str
    mini_folder: str = ""
    has_can_bus: bool = True
    image_size: tuple[int, int] | None = None

    def file_name(self, version: str, part: Part) -> str:
        """Where its converter writes a file, relative to the folder it is given."""
        folder = f"{self.mini_folder}/" if self.mini_folder and version == MINI else ""
        return f"{folder}{self.stem}_{part}.pkl"


REPOSITORIES: Final = {
    found.name: found
    for found in (
        Repository("uniad", "UniAD", "nuscenes_infos_temporal"),
        Repository("vad", "VAD", "vad_nuscenes_infos_temporal"),
        Repository(
            "sparsedrive",
            "SparseDrive and DiffusionDrive",
            "nuscenes_infos",
            mini_folder="mini",
            has_can_bus=False,
            image_size=(1600, 900),
        ),
    )
}


def find_repository(name: str) -> Repository:
    """A repository by name; raises `InputError` for any other name."""
    for candidate in REPOSITORIES.values():
        if candidate.name == name:
            return candidate
    raise InputError(f"--for {name} is not a repository with info files; use one of {', '.join(REPOSITORIES)}")


def require_version(version: str, where: str) -> None:
    """Refuse tables that official code would not open: their version's name is none of nuScenes'."""
    if version not in VERSIONS:
        raise InputError(
            f"{where} has its tables in {version}/, and official code opens only {', '.join(VERSIONS)}; copy the root "
            f"and rename that folder to {TRAINVAL}"
        )


def list_official_training_scenes(version: str) -> frozenset[str]:
    """Scenes that a converter puts into the first file of a version: all others go into the second."""
    splits = import_devkit_module("nuscenes.utils.splits")
    return frozenset({MINI: splits.mini_train, TRAINVAL: splits.train, TEST: splits.test}[version])
