"""The official weights files: where they are, under which licence, what is known of them."""

from dataclasses import dataclass
from typing import Final

from benchmark.errors import InputError

_NUSCENES: Final = "trained on nuScenes (CC BY-NC-SA 4.0, non-commercial)"


@dataclass(frozen=True, slots=True)
class OfficialFile:
    """One published file. ``None`` means that its authors do not say and nobody here has measured it.

    Attributes:
        name: File name.
        model: Which model it is for.
        url: Where the bytes are.
        page: Where a person gets it with a browser.
        licence: Of the weights, as far as their authors say.
        size_bytes: Size.
        sha256: Hash of the whole file.
        companions: Files that the weights are of no use without.
    """

    name: str
    model: str
    url: str
    page: str
    licence: str
    size_bytes: int | None = None
    sha256: str | None = None
    companions: tuple["OfficialFile", ...] = ()


def _google_drive(name: str, model: str, identifier: str, licence: str) -> OfficialFile:
    return OfficialFile(
        name=name,
        model=model,
        url=f"https://drive.usercontent.google.com/download?id={identifier}&export=download&confirm=t",
        page=f"https://drive.google.com/file/d/{identifier}/view",
        licence=licence,
    )


_APACHE_LICENCE: Final = f"not stated for the weights; code Apache-2.0; {_NUSCENES}"
_SPARSE_LICENCE: Final = f"not stated for the weights; code MIT; {_NUSCENES}"
_UNIAD_RELEASES: Final = "https://github.com/OpenDriveLab/UniAD/releases"
OFFICIAL_FILES: Final = (
    _google_drive("VAD_tiny.pth", "vad-tiny", "1KgCC_wFqPH0CQqdr6Pp2smBX5ARPaqne", _APACHE_LICENCE),
    _google_drive("VAD_base.pth", "vad-base", "1FLX-4LVm4z-RskghFbxGuYlcYOQmV5bS", _APACHE_LICENCE),
    OfficialFile(
        name="sparsedrive_stage2.pth",
        model="sparsedrive",
        url="https://github.com/swc-17/SparseDrive/releases/download/v1.0/sparsedrive_stage2.pth",
        page="https://github.com/swc-17/SparseDrive/releases/tag/v1.0",
        licence=_SPARSE_LICENCE,
    ),
    OfficialFile(
        name="diffusiondrive_nusc_stage2.pth",
        model="diffusiondrive",
        url="https://huggingface.co/hustvl/DiffusionDrive/resolve/main/diffusiondrive_nusc_stage2.pth",
        page="https://huggingface.co/hustvl/DiffusionDrive/tree/main",
        licence=_SPARSE_LICENCE,
    ),
    OfficialFile(
        name="uniad_base_e2e.pth",
        model="uniad",
        url=f"{_UNIAD_RELEASES}/download/v1.0.1/uniad_base_e2e.pth",
        page=f"{_UNIAD_RELEASES}/tag/v1.0.1",
        licence=_APACHE_LICENCE,
        companions=(
            OfficialFile(
                name="motion_anchor_infos_mode6.pkl",
                model="uniad",
                url=f"{_UNIAD_RELEASES}/download/v1.0/motion_anchor_infos_mode6.pkl",
                page=f"{_UNIAD_RELEASES}/tag/v1.0",
                licence=_APACHE_LICENCE,
            ),
        ),
    ),
)


def official_file(name: str) -> OfficialFile:
    """An official file by its own name or by its model's.

    Args:
        name: For example ``VAD_tiny.pth`` or ``vad-tiny``.

    Returns:
        The file.

    Raises:
        InputError: If there is none.
    """
    found = next((file for file in OFFICIAL_FILES if name in (file.name, file.model)), None)
    if found is None:
        known = ", ".join(f"{file.model} ({file.name})" for file in OFFICIAL_FILES)
        raise InputError(f"there is no official weights file {name!r}; known are {known}")
    return found


def how_to_import(file: OfficialFile) -> str:
    """The command that imports a file which a person fetched, with the anchors that it may need."""
    options = "".join(f" --anchors {companion.name}" for companion in file.companions)
    return f"challenger-bench weights import {file.name}{options}"
