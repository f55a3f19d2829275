"""The published weights that video quality needs."""

from typing import Final

from benchmark.quality.definition import MaskSource
from benchmark.weights.hub import HubFile, HubWeights

DINO: Final = HubWeights(
    name="dino-vitb16",
    repository="facebook/dino-vitb16",
    # The branch that adds safetensors to what is on main.
    revision="a77533c84408875b30b5e8beb766c82a5be82bf4",
    files=(HubFile("config.json"), HubFile("model.safetensors")),
    licence="Apache-2.0; trained on ImageNet-1k without labels",
    used_by="quality (subject consistency)",
    about_megabytes=343,
)
MUSIQ: Final = HubWeights(
    name="musiq-spaq",
    repository="chaofengc/IQA-PyTorch",
    revision="v0.1-weights",
    # Its authors put the first digits of the SHA-256 into the name.
    files=(HubFile("musiq_spaq_ckpt-358bb6af.pth", sha256="358bb6af"),),
    licence="CC BY-NC-SA 4.0 (non-commercial), converted from google-research/musiq (Apache-2.0); trained on SPAQ",
    used_by="quality (imaging quality)",
    about_megabytes=109,
    download_root="https://github.com/chaofengc/IQA-PyTorch/releases/download/v0.1-weights",
    page="https://github.com/chaofengc/IQA-PyTorch/releases/tag/v0.1-weights",
)
SAM2: Final = HubWeights(
    name="sam2.1-hiera-large",
    repository="facebook/sam2.1-hiera-large",
    revision="665f8e2ad61cf5f53d65644ff27c8ee525124610",
    files=(
        HubFile("config.json"),
        HubFile(
            "model.safetensors",
            size_bytes=897_897_416,
            sha256="dc407dce21301fd94abb395c5099b4f2c455fdc8a8f261ac3d0ea6d4cd197230",
        ),
    ),
    licence="Apache-2.0; trained on SA-V (CC BY 4.0)",
    used_by="quality --masks grounded-sam2 or sam2-boxes",
    about_megabytes=898,
)
GROUNDING_DINO: Final = HubWeights(
    name="grounding-dino-base",
    repository="IDEA-Research/grounding-dino-base",
    revision="12bdfa3120f3e7ec7b434d90674b3396eccf88eb",
    files=(
        HubFile("config.json"),
        HubFile(
            "model.safetensors",
            size_bytes=933_400_872,
            sha256="5548f844c928c4b6f411fa8cbcc2bfa8dbbba437cb1d513975519f93c2a9ed21",
        ),
        HubFile("preprocessor_config.json"),
        HubFile("tokenizer.json"),
        HubFile("tokenizer_config.json"),
        HubFile("vocab.txt"),
    ),
    licence="Apache-2.0",
    used_by="quality --masks grounded-sam2",
    about_megabytes=934,
)
QUALITY_WEIGHTS: Final = (DINO, MUSIQ, SAM2, GROUNDING_DINO)


def needed_for(masks: MaskSource) -> tuple[HubWeights, ...]:
    """Weights that a source of masks and the two metrics need.

    Args:
        masks: The source.

    Returns:
        In the order in which they are used.
    """
    of_masks: dict[MaskSource, tuple[HubWeights, ...]] = {
        "grounded-sam2": (GROUNDING_DINO, SAM2),
        "sam2-boxes": (SAM2,),
        "boxes": (),
    }
    return (*of_masks[masks], DINO, MUSIQ)
