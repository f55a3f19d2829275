"""Tiny random networks of the real classes, saved to disk as a user would have them."""

import string
from pathlib import Path
from typing import Any

import torch

from benchmark.extensions.quality.musiq import Musiq, MusiqConfig
from benchmark.weights.catalogue import DINO, GROUNDING_DINO, MUSIQ, SAM2

SMALL_MUSIQ = MusiqConfig(hidden=16, mlp=16, layers=1, stem=32)
SAM2_SIDE_PX = 128
DETECTOR_SIDE_PX = 128


def save_small_networks(folder: Path) -> Path:
    """Everything that quality needs, each in its folder."""
    save_scoring_networks(folder)
    save_sam2(folder / SAM2.name)
    save_grounding_dino(folder / GROUNDING_DINO.name)
    return folder


def save_scoring_networks(folder: Path) -> None:
    """What is needed where masks are boxes."""
    save_dino(folder / DINO.name)
    save_musiq(folder / MUSIQ.name)


def save_dino(folder: Path) -> None:
    from transformers import ViTConfig, ViTModel

    torch.manual_seed(1)
    config = ViTConfig(
        hidden_size=32, num_hidden_layers=2, num_attention_heads=2, intermediate_size=32, image_size=64, patch_size=16
    )
    # As published: no pooling layer.
    ViTModel(config, add_pooling_layer=False).save_pretrained(folder)


def save_musiq(folder: Path, network: Musiq | None = None) -> None:
    torch.manual_seed(2)
    folder.mkdir(parents=True, exist_ok=True)
    torch.save((network or Musiq(SMALL_MUSIQ)).state_dict(), folder / MUSIQ.files[0].name)


def save_sam2(folder: Path) -> None:
    from transformers import Sam2VideoConfig, Sam2VideoModel

    torch.manual_seed(3)
    Sam2VideoModel(Sam2VideoConfig(**sam2_settings())).save_pretrained(folder)


def sam2_settings() -> dict[str, Any]:
    hidden, side = 128, SAM2_SIDE_PX // 4
    backbone = {
        "model_type": "sam2_hiera_det_model", "hidden_size": 8, "num_attention_heads": 1,
        "image_size": [SAM2_SIDE_PX, SAM2_SIDE_PX], "blocks_per_stage": [1, 2, 2, 1],
        "embed_dim_per_stage": [8, 16, 32, 64], "num_attention_heads_per_stage": [1, 2, 4, 8],
        "window_size_per_stage": [8, 4, 4, 4], "global_attention_blocks": [4],
        "window_positional_embedding_background_size": [4, 4],
    }  # fmt: skip
    vision = {
        "model_type": "sam2_vision_model", "backbone_config": backbone, "backbone_channel_list": [64, 32, 16, 8],
        "backbone_feature_sizes": [[side // part] * 2 for part in (1, 2, 4)], "fpn_hidden_size": hidden,
    }  # fmt: skip
    return {
        "vision_config": vision,
        "prompt_encoder_config": {"hidden_size": hidden, "image_size": SAM2_SIDE_PX, "patch_size": 16},
        "mask_decoder_config": {"hidden_size": hidden, "mlp_dim": 32, "iou_head_hidden_dim": 32},
        "image_size": SAM2_SIDE_PX, "memory_attention_hidden_size": hidden, "memory_attention_num_layers": 1,
        "memory_attention_feed_forward_hidden_size": 32, "memory_attention_rope_feat_sizes": [side // 4, side // 4],
        "memory_encoder_hidden_size": hidden, "memory_encoder_output_channels": 64,
        "mask_downsampler_embed_dim": hidden, "memory_fuser_embed_dim": hidden, "memory_fuser_intermediate_dim": 32,
        "memory_fuser_num_layers": 1,
    }  # fmt: skip


def save_grounding_dino(folder: Path) -> None:
    from transformers import BertTokenizer, GroundingDinoConfig, GroundingDinoForObjectDetection
    from transformers.models.grounding_dino.image_processing_pil_grounding_dino import GroundingDinoImageProcessorPil

    folder.mkdir(parents=True, exist_ok=True)
    words = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", ".", "?", "car", *string.ascii_lowercase]
    (folder / "vocab.txt").write_text("\n".join(words) + "\n")
    torch.manual_seed(4)
    size = {"shortest_edge": DETECTOR_SIDE_PX, "longest_edge": 2 * DETECTOR_SIDE_PX}
    # As published: the two halves of the processor, each in its own file.
    BertTokenizer(str(folder / "vocab.txt")).save_pretrained(folder)
    GroundingDinoImageProcessorPil(size=size).save_pretrained(folder)
    processor = folder / "preprocessor_config.json"
    # The published file names the class that needs torchvision.
    processor.write_text(processor.read_text().replace("GroundingDinoImageProcessorPil", "GroundingDinoImageProcessor"))
    GroundingDinoForObjectDetection(GroundingDinoConfig(**detector_settings(len(words)))).save_pretrained(folder)


def detector_settings(vocabulary: int) -> dict[str, Any]:
    backbone = {
        "model_type": "swin", "image_size": DETECTOR_SIDE_PX, "embed_dim": 8, "depths": [1, 1, 1, 1],
        "num_heads": [1, 1, 2, 2], "window_size": 4, "out_indices": [2, 3, 4],
    }  # fmt: skip
    text = {
        "model_type": "bert", "vocab_size": vocabulary, "hidden_size": 16, "num_hidden_layers": 1,
        "num_attention_heads": 2, "intermediate_size": 16,
    }  # fmt: skip
    return {
        "backbone_config": backbone, "text_config": text, "d_model": 32, "encoder_layers": 1, "decoder_layers": 2,
        "encoder_attention_heads": 4, "decoder_attention_heads": 4, "encoder_ffn_dim": 32, "decoder_ffn_dim": 32,
        "num_queries": 20, "max_text_len": 16,
    }  # fmt: skip
