"""Made-up camera inputs of realistic size and geometry, for speed figures and for trying a network out."""

from typing import Final

import numpy as np

from adapters.camera_inputs import NUSCENES_IMAGE, NetworkImageFormat, Pixels
from benchmark.constants import CAMERA_NAMES
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed

_HEADINGS_DEG: Final = (0.0, -56.0, 55.0, 180.0, 108.0, -110.0)
_FOCAL_PX: Final = (1266.0, 1266.0, 1266.0, 809.0, 1260.0, 1260.0)
_BELOW_LIDAR_M: Final = 0.3


def example_images(image_format: NetworkImageFormat) -> Pixels:
    """Noise, (6, 3, H, W), in the place of normalised images, zero in the padding; the same every time."""
    generator = np.random.default_rng(content_seed("example images"))
    images = np.zeros((len(CAMERA_NAMES), 3, *image_format.padded), np.float32)
    rows = image_format.height - image_format.crop_top
    unpadded = images[:, :, :rows, : image_format.width]
    unpadded[:] = generator.standard_normal(unpadded.shape, np.float32)
    return images


def example_projections(image_format: NetworkImageFormat) -> Floats:
    """Projections, (6, 4, 4) from lidar frame to pixels, of a rig like that of nuScenes, all lenses below the lidar."""
    width, height = NUSCENES_IMAGE
    matrices = []
    for heading_rad, focal_px in zip(np.radians(_HEADINGS_DEG), _FOCAL_PX, strict=True):
        cos, sin = float(np.cos(heading_rad)), float(np.sin(heading_rad))
        # Rows: right, down and ahead of the camera, in the axes right, forward and up of the lidar.
        camera_T_lidar = np.array(
            [[cos, sin, 0, 0], [0, 0, -1, -_BELOW_LIDAR_M], [-sin, cos, 0, 0], [0, 0, 0, 1]], dtype=np.float64
        )
        intrinsic = np.diag([focal_px, focal_px, 1.0, 1.0])
        intrinsic[:2, 2] = width / 2, 0.54 * height
        affine = np.diag([image_format.width / width, image_format.height / height, 1.0, 1.0])
        affine[1, 2] = -image_format.crop_top
        matrices.append(affine @ intrinsic @ camera_T_lidar)
    return np.stack(matrices)
