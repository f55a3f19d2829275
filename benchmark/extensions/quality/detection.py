"""Grounding DINO from transformers: boxes around what a text names."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.extensions.quality.pretrained import load_pretrained
from benchmark.extensions.quality.segmentation import Box


class Detector:
    """Grounding DINO with its weights and its own processor.

    Args:
        folder: Weights of ``IDEA-Research/grounding-dino-base``, with tokenizer and image processor.
        prompt: What to look for, in lower case with a full stop.
    """

    def __init__(
        self, folder: Path, device: torch.device, prompt: str, box_threshold: float, text_threshold: float
    ) -> None:
        self._processor: Any = load_pretrained("GroundingDinoProcessor", folder, device)
        self._network: Any = load_pretrained("GroundingDinoForObjectDetection", folder, device)
        self._device, self._prompt = device, prompt
        self._box_threshold, self._text_threshold = box_threshold, text_threshold

    @torch.inference_mode()
    def boxes(self, image: NDArray[np.uint8]) -> list[Box]:
        """Boxes of the prompt inside a (height, width, 3) RGB image, the surest first."""
        from PIL import Image

        height, width = image.shape[:2]
        inputs = self._processor(images=Image.fromarray(image), text=self._prompt, return_tensors="pt").to(self._device)
        found = self._processor.post_process_grounded_object_detection(
            self._network(**inputs),
            inputs["input_ids"],
            threshold=self._box_threshold,
            text_threshold=self._text_threshold,
            target_sizes=[(height, width)],
        )[0]
        order = torch.argsort(found["scores"], descending=True, stable=True).tolist()
        boxes = found["boxes"].cpu().double().numpy()[order]
        boxes = np.clip(boxes.reshape(-1, 2, 2), 0.0, (width, height)).reshape(-1, 4)
        return [
            (float(left), float(top), float(right), float(bottom))
            for left, top, right, bottom in boxes
            if right > left and bottom > top
        ]
