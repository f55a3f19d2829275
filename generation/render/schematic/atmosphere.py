"""Light, weather and colours (RGB, 0..255): everything that makes day, dusk, night and rain look different.

Surfaces have one daylight colour; a look tints them, adds haze and turns lamps on.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from benchmark.scene import Conditions

Rgb = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Atmosphere:
    """Light and weather of a look.

    ``haze`` is the colour at the horizon, which leaves a third of a thing's contrast at ``haze_m``; ``tint`` a factor
    per channel on all surfaces. ``sun`` is a direction, (3,) not normalised, ``sun_share`` its part of the light; the
    rest comes from everywhere. ``shadow`` under vehicles and ``wetness``, dark and smooth, are 0..1; ``lamps`` also
    light windows; ``beam`` is a factor of the ego's head lamps at their brightest.
    """

    sky: Rgb
    haze: Rgb
    haze_m: float
    tint: Rgb
    sun: Rgb
    sun_share: float
    shadow: float
    wetness: float
    lamps: bool
    beam: float
    rain: bool

    def fade(self, distance_m: Floats) -> Floats:
        """Share of the haze colour at distances of (...) metres: 0 near, towards 1 far away."""
        return np.asarray(1.0 - np.exp(-((np.maximum(distance_m, 0.0) / self.haze_m) ** 1.5)))

    def compute_beam(self, ahead_m: Floats, left_m: Floats) -> Floats:
        """Factor, added to the tint, of the ego's head lamps at points ahead of the rear axle and to the left."""
        if self.beam == 0.0:
            return np.zeros(np.broadcast_shapes(np.shape(ahead_m), np.shape(left_m)))
        reach = np.maximum(np.asarray(ahead_m, np.float64) - 2.5, 0.0)
        across = np.asarray(left_m) / (1.8 + 0.30 * reach)
        along = (1.0 - np.exp(-reach / 2.0)) * np.exp(-((reach / 34.0) ** 2))
        return np.asarray(self.beam * along * np.exp(-(across**2)))


ATMOSPHERES: Final = {
    Conditions.DAY: Atmosphere(
        sky=(98, 150, 212), haze=(206, 220, 232), haze_m=135.0, tint=(1.0, 1.0, 1.0), sun=(0.45, 0.35, 0.82),
        sun_share=0.45, shadow=0.55, wetness=0.0, lamps=False, beam=0.0, rain=False,
    ),
    Conditions.DUSK: Atmosphere(
        sky=(58, 70, 116), haze=(226, 158, 118), haze_m=125.0, tint=(0.66, 0.55, 0.56), sun=(-0.85, 0.3, 0.35),
        sun_share=0.42, shadow=0.35, wetness=0.0, lamps=True, beam=0.30, rain=False,
    ),
    Conditions.NIGHT: Atmosphere(
        sky=(8, 11, 24), haze=(26, 29, 44), haze_m=95.0, tint=(0.22, 0.23, 0.30), sun=(0.2, 0.3, 0.9),
        sun_share=0.25, shadow=0.25, wetness=0.0, lamps=True, beam=0.80, rain=False,
    ),
    Conditions.RAIN: Atmosphere(
        sky=(132, 140, 150), haze=(172, 179, 186), haze_m=80.0, tint=(0.74, 0.77, 0.81), sun=(0.1, 0.1, 0.95),
        sun_share=0.25, shadow=0.25, wetness=0.6, lamps=True, beam=0.10, rain=True,
    ),
}  # fmt: skip

ASPHALT: Final[Rgb] = (92, 93, 97)
WET_ASPHALT: Final[Rgb] = (62, 66, 74)
GRASS: Final[Rgb] = (112, 134, 84)
PAVEMENT: Final[Rgb] = (164, 160, 154)
CAR_PARK: Final[Rgb] = (108, 108, 112)
KERB: Final[Rgb] = (196, 194, 188)
WHITE_PAINT: Final[Rgb] = (238, 238, 236)
YELLOW_PAINT: Final[Rgb] = (232, 186, 52)

# Colour and share of traffic, after the usual statistics of paint makers: white, black and greys first.
_CAR_PAINTS: Final[tuple[tuple[Rgb, int], ...]] = (
    ((232, 232, 230), 7), ((34, 35, 38), 5), ((118, 121, 126), 5), ((178, 181, 184), 4), ((44, 76, 138), 3),
    ((150, 32, 34), 3), ((92, 72, 58), 1), ((52, 84, 66), 1), ((206, 190, 158), 1), ((214, 120, 40), 1),
)  # fmt: skip
_CLOTHES: Final[tuple[Rgb, ...]] = (
    (172, 48, 44), (46, 74, 128), (60, 62, 66), (206, 200, 188), (84, 120, 78), (196, 150, 60), (120, 74, 128),
)  # fmt: skip
_FACADES: Final[tuple[Rgb, ...]] = (
    (186, 168, 146), (160, 112, 92), (196, 194, 188), (142, 148, 156), (206, 186, 150), (128, 118, 112),
    (172, 152, 136),
)  # fmt: skip


def choose_car_paint(instance: str, salt: tuple[str, ...] = ()) -> Rgb:
    """Paint of a vehicle, from its identifier alone: nothing else may tell an adversary from other cars."""
    wheel = [paint for paint, share in _CAR_PAINTS for _ in range(share)]
    return wheel[content_seed("paint", *salt, instance) % len(wheel)]


def choose_clothes(instance: str, salt: tuple[str, ...] = ()) -> Rgb:
    """Colour of a person's clothes, from the identifier alone."""
    return _CLOTHES[content_seed("clothes", *salt, instance) % len(_CLOTHES)]


def choose_facade(seed: int, salt: tuple[str, ...] = ()) -> Rgb:
    """Colour of a building."""
    return _FACADES[(content_seed("facade", *salt, seed) if salt else seed) % len(_FACADES)]
