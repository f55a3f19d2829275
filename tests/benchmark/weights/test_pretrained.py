"""Other people's libraries must not change what PyTorch does for the rest of the process."""

from pathlib import Path

import torch
from torch.utils import _device

from benchmark.weights.pretrained import OptionalLibrary


def test_devices_of_new_tensors_are_what_they_were_before_a_network_was_loaded(tmp_path: Path) -> None:
    from transformers import ViTConfig, ViTModel

    config = ViTConfig(
        hidden_size=32, num_hidden_layers=1, num_attention_heads=2, intermediate_size=32, image_size=64, patch_size=16
    )
    ViTModel(config, add_pooling_layer=False).save_pretrained(tmp_path)
    # As in a process that has not used a device context yet.
    _device._device_constructors.cache_clear()
    OptionalLibrary("transformers", "quality", "the test").load("ViTModel", tmp_path, add_pooling_layer=False)
    with torch.device("meta"):
        assert torch.linspace(0, 1, 2).device.type == torch.empty(1).device.type == "meta"
