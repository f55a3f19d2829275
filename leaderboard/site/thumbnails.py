"""One small picture of each scene, for lists."""

from typing import Final

import cv2
import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import box_gap
from benchmark.records.scenes import Sheet
from benchmark.report.birdseye import SceneFromAbove
from benchmark.report.palette import ON_LIGHT, GroundColours
from benchmark.report.placing import agent_box, ego_box

THUMBNAIL_PX: Final = 320
THUMBNAIL_EXTENT_M: Final = 20.0
_QUALITY: Final = 80


def thumbnail(sheet: Sheet, colours: GroundColours = ON_LIGHT) -> bytes:
    """A WebP picture of 320 x 320 pixels: the scene, which has frames, from above in its `closest_frame`.

    Raises:
        InputError: If OpenCV was built without WebP.
    """
    image, _ = SceneFromAbove(sheet, colours).draw(
        closest_frame(sheet), width_px=THUMBNAIL_PX, height_px=THUMBNAIL_PX, extent_m=THUMBNAIL_EXTENT_M
    )
    done, encoded = cv2.imencode(".webp", image[:, :, ::-1], [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    if not done:
        raise InputError(f"OpenCV cannot write the WebP picture of {sheet.scene}; install a build of it that has WebP")
    return encoded.tobytes()


def closest_frame(sheet: Sheet) -> int:
    """First frame in which an adversary's box is closest to the recorded ego's; the middle one without adversaries."""
    adversaries = [agent for agent in sheet.agents if agent.adversary]
    best = (np.inf, len(sheet.timestamps_us) // 2)
    for frame in range(len(sheet.timestamps_us)):
        boxes = [box for box in (agent_box(agent, frame) for agent in adversaries) if box is not None]
        if boxes:
            best = min(best, (float(box_gap(ego_box(sheet, frame), np.array(boxes)).min()), frame))
    return best[1]
