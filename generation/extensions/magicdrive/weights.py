"""Where the published weights that photorealistic rendering needs are on this machine."""

from dataclasses import dataclass
from pathlib import Path

from benchmark.machine.storage import content_key
from benchmark.weights.catalogue import AUTOENCODER, TEXT_ENCODER, TRANSFORMER
from benchmark.weights.folders import compute_content_hash, require_folder_of


@dataclass(frozen=True, slots=True)
class NetworkFiles:
    """Places of the networks; ``fingerprint`` is of transformer and decoder, 64 hexadecimal digits."""

    transformer: Path
    autoencoder: Path
    text_encoder: Path
    fingerprint: str
    text_fingerprint: str

    @classmethod
    def find(cls, given: Path | None, cache: Path | None = None) -> "NetworkFiles":
        """Look for the weights in a folder, or the cache of all weights; a refusal says what to get, where, how big."""
        places = {
            weights: require_folder_of(weights, given, cache) for weights in (TRANSFORMER, AUTOENCODER, TEXT_ENCODER)
        }
        hashes = {weights: compute_content_hash(weights, place) for weights, place in places.items()}
        return cls(
            transformer=places[TRANSFORMER] / "ema.pt",
            autoencoder=places[AUTOENCODER] / "vae",
            text_encoder=places[TEXT_ENCODER],
            fingerprint=content_key(hashes[TRANSFORMER], hashes[AUTOENCODER]),
            text_fingerprint=hashes[TEXT_ENCODER],
        )
