"""Every published file of weights that a command uses: where it is, under which licence, what is known of it.

There are two kinds. Checkpoints of planners are single files, which an import turns into weights of ours
(`adapters.checkpoints`). Weights that other libraries load want a folder with a configuration beside the tensors; they
are kept as they come (`benchmark.weights.folders`).
"""

from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Final
from urllib.parse import quote

from benchmark.errors import InputError, did_you_mean

HUB: Final = "https://huggingface.co"


@dataclass(frozen=True, slots=True)
class PublishedFile:
    """One file. ``None`` means that its authors do not say and it has not been measured here.

    ``name`` is its path in repository and folder, with ``/``; ``sha256`` may be the first digits alone, as authors put
    them into a name. ``url`` is where the bytes are, if not on the hub, ``page`` where a browser gets it, if not where
    all are.
    """

    name: str
    size_bytes: int | None = None
    sha256: str | None = None
    url: str | None = None
    page: str | None = None


@dataclass(frozen=True, slots=True)
class PublishedWeights:
    """Weights as they are published.

    Attributes:
        name: The model that a checkpoint is for, or the folder in the cache.
        files: Of a checkpoint the file itself, and what it is of no use without.
        repository: Of a folder: ``owner/name`` on the hub (or on GitHub, where files have addresses of their own).
        revision: Of a folder: commit, branch or release tag.
        used_by: Of a folder: which command needs it for what.
        about_megabytes: Where sizes are not known to the byte.
        page: Where a person gets them, if not on the hub.
    """

    name: str
    files: tuple[PublishedFile, ...]
    licence: str
    repository: str = ""
    revision: str = ""
    used_by: str = ""
    about_megabytes: int | None = None
    page: str | None = None

    def __post_init__(self) -> None:
        for file in self.files:
            parts = PurePosixPath(file.name).parts
            if not parts or file.name.startswith("/") or any(part in ("..", ".") for part in parts):
                raise ValueError(f"weights {self.name}: {file.name!r} is not a file inside their folder")

    @property
    def is_folder(self) -> bool:
        """Whether they are kept as they come; else an import makes weights of ours of them."""
        return bool(self.repository)

    @property
    def address(self) -> str:
        """Where a person gets them with a browser."""
        return self.page or f"{HUB}/{self.repository}/tree/{self.revision}"

    @property
    def size_text(self) -> str:
        """How big they are, in words."""
        sizes = [file.size_bytes for file in self.files if file.size_bytes is not None]
        if len(sizes) == len(self.files):
            return f"{sum(sizes) / 1e6:.0f} MB"
        return "size unknown" if self.about_megabytes is None else f"about {self.about_megabytes} MB"

    @property
    def names(self) -> str:
        """Names of the files, for sentences."""
        return ", ".join(file.name for file in self.files)

    @property
    def how_to_import(self) -> str:
        """The command that imports what a person fetched, with the anchors that a checkpoint may need."""
        if self.is_folder:
            return f"challenger-bench weights import FOLDER --model {self.name}"
        checkpoint, *companions = self.files
        options = "".join(f" --anchors {companion.name}" for companion in companions)
        return f"challenger-bench weights import {checkpoint.name}{options}"

    def url(self, file: PublishedFile) -> str:
        """Where the bytes of a file are."""
        return file.url or f"{HUB}/{self.repository}/resolve/{self.revision}/{quote(file.name)}"


def find_checkpoint(name: str) -> PublishedWeights:
    """The published checkpoint of a planner, by file (``VAD_tiny.pth``) or by model (``vad-tiny``)."""
    checkpoint = next((entry for entry in CHECKPOINTS if name in (entry.name, entry.files[0].name)), None)
    if checkpoint is None:
        known = ", ".join(f"{entry.name} ({entry.files[0].name})" for entry in CHECKPOINTS)
        close = did_you_mean(
            name, [known_name for entry in CHECKPOINTS for known_name in (entry.name, entry.files[0].name)]
        )
        raise InputError(f"unknown official weights file {name!r}; {close}choose from {known}")
    return checkpoint


def _google_drive(model: str, name: str, identifier: str) -> PublishedWeights:
    url = f"https://drive.usercontent.google.com/download?id={identifier}&export=download&confirm=t"
    page = f"https://drive.google.com/file/d/{identifier}/view"
    return PublishedWeights(model, (PublishedFile(name, url=url, page=page),), _APACHE_LICENCE)


_NUSCENES: Final = "trained on nuScenes (CC BY-NC-SA 4.0, non-commercial)"
_APACHE_LICENCE: Final = f"not stated for the weights; code Apache-2.0; {_NUSCENES}"
_SPARSE_LICENCE: Final = f"not stated for the weights; code MIT; {_NUSCENES}"
_SPARSEDRIVE: Final = "https://github.com/swc-17/SparseDrive/releases"
_UNIAD: Final = "https://github.com/OpenDriveLab/UniAD/releases"
_IQA: Final = "https://github.com/chaofengc/IQA-PyTorch/releases"
CHECKPOINTS: Final = (
    _google_drive("vad-tiny", "VAD_tiny.pth", "1KgCC_wFqPH0CQqdr6Pp2smBX5ARPaqne"),
    _google_drive("vad-base", "VAD_base.pth", "1FLX-4LVm4z-RskghFbxGuYlcYOQmV5bS"),
    PublishedWeights(
        "sparsedrive",
        (
            PublishedFile(
                "sparsedrive_stage2.pth",
                url=f"{_SPARSEDRIVE}/download/v1.0/sparsedrive_stage2.pth",
                page=f"{_SPARSEDRIVE}/tag/v1.0",
            ),
        ),
        _SPARSE_LICENCE,
    ),
    PublishedWeights(
        "diffusiondrive",
        (
            PublishedFile(
                "diffusiondrive_nusc_stage2.pth",
                url=f"{HUB}/hustvl/DiffusionDrive/resolve/main/diffusiondrive_nusc_stage2.pth",
                page=f"{HUB}/hustvl/DiffusionDrive/tree/main",
            ),
        ),
        _SPARSE_LICENCE,
    ),
    PublishedWeights(
        "uniad",
        (
            PublishedFile(
                "uniad_base_e2e.pth",
                url=f"{_UNIAD}/download/v1.0.1/uniad_base_e2e.pth",
                page=f"{_UNIAD}/tag/v1.0.1",
            ),
            PublishedFile(
                "motion_anchor_infos_mode6.pkl",
                url=f"{_UNIAD}/download/v1.0/motion_anchor_infos_mode6.pkl",
                page=f"{_UNIAD}/tag/v1.0",
            ),
        ),
        _APACHE_LICENCE,
    ),
)
"""Official checkpoints of planners."""

_RENDERING: Final = "generate --renderer magicdrive"
TRANSFORMER: Final = PublishedWeights(
    "magicdrive-dit",
    (PublishedFile("ema.pt"),),
    "not stated by its authors; trained on nuScenes (CC BY-NC-SA 4.0, non-commercial)",
    repository="flymin/MagicDriveDiT-stage3-40k-ft",
    revision="main",
    used_by=_RENDERING,
    about_megabytes=8150,
)
AUTOENCODER: Final = PublishedWeights(
    "cogvideox-vae",
    (PublishedFile("vae/config.json"), PublishedFile("vae/diffusion_pytorch_model.safetensors")),
    "Apache-2.0",
    repository="THUDM/CogVideoX-2b",
    revision="main",
    used_by=_RENDERING,
    about_megabytes=431,
)
TEXT_ENCODER: Final = PublishedWeights(
    "t5-v1.1-xxl",
    (
        PublishedFile("config.json"),
        # Read with PyTorch's weights-only unpickler; its decoder is left out.
        PublishedFile("pytorch_model.bin"),
        PublishedFile("special_tokens_map.json"),
        PublishedFile("spiece.model"),
        PublishedFile("tokenizer_config.json"),
    ),
    "Apache-2.0",
    repository="google/t5-v1_1-xxl",
    revision="main",
    used_by=_RENDERING,
    about_megabytes=44500,
)
DINO: Final = PublishedWeights(
    "dino-vitb16",
    (PublishedFile("config.json"), PublishedFile("model.safetensors")),
    "Apache-2.0; trained on ImageNet-1k without labels",
    repository="facebook/dino-vitb16",
    # The branch that adds safetensors to the files of main.
    revision="a77533c84408875b30b5e8beb766c82a5be82bf4",
    used_by="quality (subject consistency)",
    about_megabytes=343,
)
MUSIQ: Final = PublishedWeights(
    "musiq-spaq",
    (
        # Its name holds the first digits of the SHA-256.
        PublishedFile(
            "musiq_spaq_ckpt-358bb6af.pth",
            sha256="358bb6af",
            url=f"{_IQA}/download/v0.1-weights/musiq_spaq_ckpt-358bb6af.pth",
        ),
    ),
    "CC BY-NC-SA 4.0 (non-commercial), converted from google-research/musiq (Apache-2.0); trained on SPAQ",
    repository="chaofengc/IQA-PyTorch",
    revision="v0.1-weights",
    used_by="quality (imaging quality)",
    about_megabytes=109,
    page=f"{_IQA}/tag/v0.1-weights",
)
SAM2: Final = PublishedWeights(
    "sam2.1-hiera-large",
    (
        PublishedFile("config.json"),
        PublishedFile(
            "model.safetensors",
            size_bytes=897_897_416,
            sha256="dc407dce21301fd94abb395c5099b4f2c455fdc8a8f261ac3d0ea6d4cd197230",
        ),
    ),
    "Apache-2.0; trained on SA-V (CC BY 4.0)",
    repository="facebook/sam2.1-hiera-large",
    revision="665f8e2ad61cf5f53d65644ff27c8ee525124610",
    used_by="quality --masks grounded-sam2 or sam2-boxes",
    about_megabytes=898,
)
GROUNDING_DINO: Final = PublishedWeights(
    "grounding-dino-base",
    (
        PublishedFile("config.json"),
        PublishedFile(
            "model.safetensors",
            size_bytes=933_400_872,
            sha256="5548f844c928c4b6f411fa8cbcc2bfa8dbbba437cb1d513975519f93c2a9ed21",
        ),
        PublishedFile("preprocessor_config.json"),
        PublishedFile("tokenizer.json"),
        PublishedFile("tokenizer_config.json"),
        PublishedFile("vocab.txt"),
    ),
    "Apache-2.0",
    repository="IDEA-Research/grounding-dino-base",
    revision="12bdfa3120f3e7ec7b434d90674b3396eccf88eb",
    used_by="quality --masks grounded-sam2",
    about_megabytes=934,
)
FOLDERS: Final = (TRANSFORMER, AUTOENCODER, TEXT_ENCODER, DINO, MUSIQ, SAM2, GROUNDING_DINO)
"""Weights that are kept as folders: of photorealistic rendering, then of video quality."""
