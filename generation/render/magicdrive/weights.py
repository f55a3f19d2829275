"""The published weights that photorealistic rendering needs, and where they are on this machine."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmark.machine.storage import content_key
from benchmark.weights.hub import HubFile, HubWeights, content_hash, folder_of

_USED_BY: Final = "generate --renderer magicdrive"
TRANSFORMER: Final = HubWeights(
    name="magicdrive-dit",
    repository="flymin/MagicDriveDiT-stage3-40k-ft",
    revision="main",
    files=(HubFile("ema.pt"),),
    licence="not stated by its authors; trained on nuScenes (CC BY-NC-SA 4.0, non-commercial)",
    used_by=_USED_BY,
    about_megabytes=8150,
)
AUTOENCODER: Final = HubWeights(
    name="cogvideox-vae",
    repository="THUDM/CogVideoX-2b",
    revision="main",
    files=(HubFile("vae/config.json"), HubFile("vae/diffusion_pytorch_model.safetensors")),
    licence="Apache-2.0",
    used_by=_USED_BY,
    about_megabytes=431,
)
TEXT_ENCODER: Final = HubWeights(
    name="t5-v1.1-xxl",
    repository="google/t5-v1_1-xxl",
    revision="main",
    files=(
        HubFile("config.json"),
        # Read with PyTorch's weights-only unpickler; its decoder is left out.
        HubFile("pytorch_model.bin"),
        HubFile("special_tokens_map.json"),
        HubFile("spiece.model"),
        HubFile("tokenizer_config.json"),
    ),
    licence="Apache-2.0",
    used_by=_USED_BY,
    about_megabytes=44500,
)
MAGICDRIVE_WEIGHTS: Final = (TRANSFORMER, AUTOENCODER, TEXT_ENCODER)


@dataclass(frozen=True, slots=True)
class NetworkFiles:
    """Where the three networks lie.

    Attributes:
        transformer: File of the diffusion transformer.
        autoencoder: Folder of the video decoder.
        text_encoder: Folder of the text encoder.
        fingerprint: Of the transformer and the decoder, 64 hexadecimal digits.
        text_fingerprint: Of the text encoder.
    """

    transformer: Path
    autoencoder: Path
    text_encoder: Path
    fingerprint: str
    text_fingerprint: str

    @classmethod
    def find(cls, given: Path | None, cache: Path | None = None) -> "NetworkFiles":
        """Look for the weights.

        Args:
            given: Folder that holds them, or ``None`` for the cache.
            cache: Folder of all weights; the user's by default.

        Returns:
            Their places.

        Raises:
            InputError: If some are missing: what to get, where, how big.
        """
        places = {weights: folder_of(weights, given, cache) for weights in MAGICDRIVE_WEIGHTS}
        hashes = {weights: content_hash(weights, place) for weights, place in places.items()}
        return cls(
            transformer=places[TRANSFORMER] / "ema.pt",
            autoencoder=places[AUTOENCODER] / "vae",
            text_encoder=places[TEXT_ENCODER],
            fingerprint=content_key(hashes[TRANSFORMER], hashes[AUTOENCODER]),
            text_fingerprint=hashes[TEXT_ENCODER],
        )
