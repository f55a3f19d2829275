"""How the model's pictures lie in those of the camera, and the calibration that goes with each (section 9).

The model was trained on images of 1600 x 900 pixels, brought down by a whole factor to its width and cut at the top to
its height.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.scene import Camera
from generation.extensions.magicdrive.sensor_frames import CALIBRATION_SIZE

OutputSize = Literal["model", "1600x900"]
_CELL_PX: Final = 8


@dataclass(frozen=True, slots=True)
class ImageGeometry:
    """Sizes of the pictures that are drawn and of those that are written.

    Attributes:
        output: Enlarged to the camera's full size, which is that of the published data sets and what SparseDrive's crop
            needs, or ``model`` for pictures as they are drawn. At full size the rows that the model does not draw, 4 of
            900 at 224 x 400, repeat the first one below.
    """

    height: int = 224
    width: int = 400
    output: OutputSize = "1600x900"

    def __post_init__(self) -> None:
        full_width, full_height = CALIBRATION_SIZE
        if self.width % _CELL_PX or self.height % _CELL_PX or min(self.width, self.height) < _CELL_PX:
            raise InputError(f"MagicDriveDiT draws multiples of 8 pixels, not {self.height}x{self.width}")
        if self.height > self.width * full_height / full_width:
            raise InputError(f"pictures of {self.height}x{self.width} are higher than those of a nuScenes camera")

    @property
    def scale(self) -> float:
        """Pixels of a drawn picture for one of the camera."""
        return self.width / CALIBRATION_SIZE[0]

    @property
    def cut_rows(self) -> float:
        """Rows above the drawn picture that the camera sees, in drawn pixels."""
        return CALIBRATION_SIZE[1] * self.scale - self.height

    def camera(self, camera: Camera) -> Camera:
        """A camera with the calibration of the written picture."""
        full = camera.resized(*CALIBRATION_SIZE)
        if self.output != "model":
            return full
        intrinsic = np.diag([self.scale, self.scale, 1.0]) @ full.intrinsic
        intrinsic[1] -= self.cut_rows * intrinsic[2]
        return replace(full, intrinsic=intrinsic, width=self.width, height=self.height)

    def picture(self, drawn: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Drawn picture, (height, width, 3) RGB, at the size of the output."""
        if self.output == "model":
            return drawn
        width, height = CALIBRATION_SIZE
        large = cv2.resize(drawn, (width, round(self.height / self.scale)), interpolation=cv2.INTER_LINEAR)
        return np.asarray(np.pad(large, ((height - len(large), 0), (0, 0), (0, 0)), mode="edge"), np.uint8)
