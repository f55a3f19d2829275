"""Two ways to draw the same scene: what re-rendering alone does to a planner is the difference between them.

The embedded town and imported recordings are drawn in the first style. What is generated from them, `val-r` and `adv`,
is drawn in the second, as the paper's re-rendered and adversarial scenes come from another pipeline than the camera
that recorded them. Geometry, occlusion, what is where and when are the same in both; everything below is not:

- textures: cars, clothes and facades have other colours, the ground a rougher grain, its surfaces other tones;
- light: the sun stands a third of a turn on and lower and gives more of the light, shadows are deeper, air hazier;
- lens and sensor: a little out of focus, dark in the corners, a warm white balance, a harder tone curve, sensor noise;
- a camera's own JPEG at 4:2:0 before the one that every picture in a data set is stored as.

All of it is fixed; what is drawn by chance hangs on the instance, the camera and the frame alone.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from generation.render.schematic.atmosphere import Atmosphere, Rgb
from generation.render.schematic.painting import PaintCoat

_LEVELS: Final = 256
_NOISE_TILE: Final = 512


@dataclass(frozen=True, slots=True)
class CameraPipeline:
    """Effects of a camera on the light that reaches it; see `develop`.

    ``blur`` is a standard deviation as a share of the image's width, ``vignette`` the light lost in the corners, a
    ``gamma`` above 1 harder. Noise, in grey levels of 0..255, is ``read_noise`` in the dark and rises by ``shot_noise``
    with the square root of the grey level. ``jpeg_quality`` is of the camera's own compression.
    """

    blur: float
    vignette: float
    white_balance: Rgb
    gamma: float
    read_noise: float
    shot_noise: float
    jpeg_quality: int


@dataclass(frozen=True, slots=True)
class DrawingStyle:
    """Way of drawing a scene beyond its content, as factors on the sun, shadows, the distance of haze and channels.

    The first style has an empty ``name``, a part of the renderer's. ``salt`` goes into every random choice of a colour
    or texture; ``surfaces`` that are not named stay; ``fine_grain`` and soft ``patches`` of the ground are standard
    deviations in grey levels.
    """

    name: str = ""
    salt: tuple[str, ...] = ()
    sun_turn_rad: float = 0.0
    sun_height: float = 1.0
    sun_share: float = 1.0
    shadow: float = 1.0
    haze: float = 1.0
    sky: Rgb = (1.0, 1.0, 1.0)
    surfaces: Mapping[PaintCoat, Rgb] = field(default_factory=dict)
    fine_grain: float = 4.0
    patches: float = 5.0
    pipeline: CameraPipeline | None = None

    def apply_light(self, air: Atmosphere) -> Atmosphere:
        """Light and weather of the first style, lit as in this one."""
        cos, sin = np.cos(self.sun_turn_rad), np.sin(self.sun_turn_rad)
        x, y, z = air.sun
        return replace(
            air,
            sun=(float(cos * x - sin * y), float(sin * x + cos * y), self.sun_height * z),
            sun_share=self.sun_share * air.sun_share,
            shadow=self.shadow * air.shadow,
            haze_m=self.haze * air.haze_m,
            sky=tint(air.sky, self.sky),
            haze=tint(air.haze, self.sky),
        )

    def surface(self, coat: PaintCoat, colour: Rgb) -> Rgb:
        """Colour of a surface in this style."""
        return tint(colour, self.surfaces[coat]) if coat in self.surfaces else colour


FIRST: Final = DrawingStyle()
SECOND: Final = DrawingStyle(
    name="restyled",
    salt=("restyled",),
    sun_turn_rad=2.1,
    sun_height=0.7,
    sun_share=1.25,
    shadow=1.2,
    haze=0.8,
    sky=(1.04, 0.97, 0.90),
    surfaces={
        PaintCoat.CAR_PARK: (0.92, 0.90, 0.88),
        PaintCoat.PAVEMENT: (0.90, 0.92, 0.95),
        PaintCoat.KERB: (0.93, 0.93, 0.93),
        PaintCoat.ROAD: (1.12, 1.09, 1.05),
        PaintCoat.WHITE: (0.93, 0.92, 0.88),
        PaintCoat.YELLOW: (0.95, 0.98, 1.05),
    },
    fine_grain=7.0,
    patches=8.0,
    pipeline=CameraPipeline(
        blur=0.0012,
        vignette=0.30,
        white_balance=(1.05, 1.0, 0.93),
        gamma=1.12,
        read_noise=1.2,
        shot_noise=0.22,
        jpeg_quality=75,
    ),
)
STYLES: Final = {style.name: style for style in (FIRST, SECOND)}
"""By name."""


def tint(colour: Rgb, factor: Rgb) -> Rgb:
    """A colour times a factor for each channel, at most white."""
    red, green, blue = (min(value * by, 255.0) for value, by in zip(colour, factor))
    return red, green, blue


def develop(image: NDArray[np.uint8], pipeline: CameraPipeline, seed: int) -> NDArray[np.uint8]:
    """Picture that a camera delivers of a sharp one without noise, (H, W, 3) RGB."""
    height, width = image.shape[:2]
    curve, deviation = _build_tables(pipeline)
    light = cv2.LUT(cv2.GaussianBlur(image, (0, 0), pipeline.blur * width), curve)
    light = cv2.multiply(light, _compute_falloff(height, width, pipeline.vignette), dst=light)
    # Sensor noise depends on the grey level: a table. Light is never negative.
    spread = cv2.LUT(np.minimum(light, 255.0).astype(np.uint8), deviation)
    spread = cv2.multiply(spread, _select_noise(height, width, seed), dst=spread)
    # The sum is rounded to even and cut to 0..255 on its way into bytes.
    exposed = cv2.add(light, spread, dtype=cv2.CV_8U)
    options = [cv2.IMWRITE_JPEG_QUALITY, pipeline.jpeg_quality]
    _, stored = cv2.imencode(".jpg", cv2.cvtColor(exposed, cv2.COLOR_RGB2BGR), options)
    return np.asarray(cv2.cvtColor(cv2.imdecode(stored, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), dtype=np.uint8)


@functools.lru_cache(maxsize=4)
def _build_tables(pipeline: CameraPipeline) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(256, 1, 3) tone curve with white balance, and (256,) deviation of the noise, by grey level."""
    level = np.arange(_LEVELS, dtype=np.float64)
    tone = 255.0 * (level / 255.0) ** pipeline.gamma
    curve = tone[:, None, None] * np.array(pipeline.white_balance)
    return curve.astype(np.float32), (pipeline.read_noise + pipeline.shot_noise * np.sqrt(level)).astype(np.float32)


@functools.lru_cache(maxsize=8)
def _compute_falloff(height: int, width: int, lost: float) -> NDArray[np.float32]:
    """(H, W, 3) share of the light that arrives, the same in every channel."""
    y, x = np.mgrid[:height, :width]
    radius = np.hypot((2 * x + 1 - width) / width, (2 * y + 1 - height) / height) / np.sqrt(2.0)
    return np.repeat((1.0 - lost * radius**3)[..., None].astype(np.float32), 3, axis=-1)


def _select_noise(height: int, width: int, seed: int) -> NDArray[np.float32]:
    """(H, W, 3) normal noise: a fixed tile, laid from another corner each time; to be read, not to be written."""
    down, right = np.random.default_rng(seed).integers(0, _NOISE_TILE, 2).tolist()
    return _build_tiled_noise(height, width)[down : down + height, right : right + width]


@functools.lru_cache(maxsize=2)
def _build_tiled_noise(height: int, width: int) -> NDArray[np.float32]:
    """The tile side by side, so that a picture can be cut out from every corner of the first."""
    random = np.random.default_rng(content_seed("sensor noise"))
    tile = random.standard_normal((_NOISE_TILE, _NOISE_TILE, 3), dtype=np.float32)
    return np.pad(tile, ((0, height), (0, width), (0, 0)), mode="wrap")


def build_grain_tile(count: int, resolution_m: float, style: DrawingStyle) -> NDArray[np.uint8]:
    """Roughness of real surfaces, (count, count, 3) grey noise around 128 in fine grain and patches, seamless."""
    random = np.random.default_rng(content_seed("grain", *style.salt, count))
    fine = random.normal(0.0, style.fine_grain, (count, count))
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(count, resolution_m), np.fft.fftfreq(count, resolution_m)))
    patches = np.fft.ifft2(np.fft.fft2(random.normal(size=(count, count))) * np.exp(-((frequency / 0.4) ** 2))).real
    around: Floats = 128.0 + fine + style.patches * patches / max(float(patches.std()), 1e-9)
    return np.repeat(np.clip(np.rint(around), 0, 255).astype(np.uint8)[..., None], 3, axis=-1)
