"""Words to hidden states: T5 v1.1 XXL, which is loaded for the words of a scene and let go of again (section 4.1)."""

from pathlib import Path
from typing import Any, Final

import torch

from benchmark.weights.pretrained import Library
from generation.extensions.magicdrive.conditions import TEXT_TOKENS, TextStates

TRANSFORMERS: Final = Library("transformers", extra="render", needed_by="the renderer magicdrive")


class T5TextEncoder:
    """The published text encoder, in single precision as the published scripts use it."""

    def __init__(self, folder: Path, device: torch.device, tokens: int = TEXT_TOKENS) -> None:
        """Load the encoder: configuration, weights and vocabulary; needs transformers.

        ``tokens`` is the length to which prompts are padded or cut.
        """
        self._tokens, self._device = tokens, device
        self._tokenizer: Any = TRANSFORMERS.load("AutoTokenizer", folder)
        self._network: Any = TRANSFORMERS.load("T5EncoderModel", folder, use_safetensors=False).to(device)

    @torch.no_grad()
    def encode(self, prompt: str) -> TextStates:
        """Hidden states of a prompt as it is, padded or cut, and which of them belong to words, on the processor."""
        words = self._tokenizer(
            prompt,
            max_length=self._tokens,
            padding="max_length",
            truncation=True,
            return_attention_mask=True,
            return_tensors="pt",
        ).to(self._device)
        hidden = self._network(input_ids=words["input_ids"], attention_mask=words["attention_mask"])
        return TextStates(hidden.last_hidden_state[0].float().cpu(), words["attention_mask"][0].bool().cpu())
