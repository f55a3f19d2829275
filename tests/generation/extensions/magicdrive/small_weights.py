"""Weights of three tiny random networks in a folder, as a user has the published ones."""

import importlib
import json
from pathlib import Path
from typing import Any

import sentencepiece
import torch

from benchmark.scene import Scene
from generation.extensions.magicdrive.prompt import PromptLook
from generation.extensions.magicdrive.renderer import MagicDriveRenderer, RenderSettings
from generation.extensions.magicdrive.sampling import SamplingOptions
from generation.extensions.magicdrive.sensor_frames import ImageGeometry, OutputSize
from generation.extensions.magicdrive.weights import NetworkFiles
from tests.generation.extensions.magicdrive.busy_scenes import busy_scene
from tests.generation.extensions.magicdrive.small_network import TINY, small_network

CONFIG = TINY
SIZE = (24, 48)
_TEXT = "A driving scene image at boston-seaport. Straight road, day.\nDaytime. rain, night, umbrella, queenstown\n"


def write_weights(folder: Path) -> Path:
    """All files that rendering needs (`benchmark.weights.catalogue`), in folders called as on the hub."""
    transformer = folder / "MagicDriveDiT-stage3-40k-ft"
    transformer.mkdir(parents=True)
    torch.save(small_network(CONFIG).state_dict(), transformer / "ema.pt")
    torch.manual_seed(1)
    diffusers: Any = importlib.import_module("diffusers")
    decoder = diffusers.AutoencoderKLCogVideoX(
        block_out_channels=(4, 4, 4, 4), layers_per_block=1, norm_num_groups=2, latent_channels=16
    )
    decoder.save_pretrained(folder / "CogVideoX-2b" / "vae")
    _write_text_encoder(folder / "t5-v1_1-xxl")
    return folder


def _write_text_encoder(folder: Path) -> None:
    folder.mkdir()
    (folder / "corpus.txt").write_text(_TEXT * 20)
    sentencepiece.SentencePieceTrainer.train(
        input=str(folder / "corpus.txt"),
        model_prefix=str(folder / "spiece"),
        vocab_size=60,
        hard_vocab_limit=False,
        pad_id=0,
        eos_id=1,
        unk_id=2,
        bos_id=-1,
        minloglevel=2,
    )
    transformers: Any = importlib.import_module("transformers")
    config = transformers.T5Config(
        vocab_size=200,
        d_model=CONFIG.caption_channels,
        d_kv=4,
        d_ff=16,
        num_layers=1,
        num_heads=2,
        feed_forward_proj="gated-gelu",
        tie_word_embeddings=False,
    )
    config.save_pretrained(folder)
    torch.save(transformers.T5ForConditionalGeneration(config).state_dict(), folder / "pytorch_model.bin")
    special = {"eos_token": "</s>", "unk_token": "<unk>", "pad_token": "<pad>"}
    (folder / "special_tokens_map.json").write_text(json.dumps(special))
    (folder / "tokenizer_config.json").write_text(
        json.dumps({**special, "extra_ids": 100, "tokenizer_class": "T5Tokenizer"})
    )


def small_renderer(
    weights: Path,
    work: Path,
    *,
    seed: int = 0,
    output: OutputSize = "model",
    look: PromptLook = PromptLook.RECORDED,
    steps: int = 2,
) -> MagicDriveRenderer:
    settings = RenderSettings(
        geometry=ImageGeometry(*SIZE, output), look=look, seed=seed, sampling=SamplingOptions(steps=steps), device="cpu"
    )
    return MagicDriveRenderer(settings, NetworkFiles.find(weights), work, CONFIG)


def brief_scene(frames: int = 7) -> Scene:
    return busy_scene(frames / 12)
