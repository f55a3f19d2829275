"""Sky, skyline and ground of one view, with haze and light."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from generation.render.schematic.atmosphere import Atmosphere
from generation.render.schematic.ground import FINE_UNTIL_M, MIDDLE_UNTIL_M, PlanView
from generation.render.schematic.view import PlacedCamera

_SAMPLES = (1, 2, 4, 6)
_TEXELS_PER_SAMPLE = 2.5
_SKYLINE_BLOCKS = 90
_HORIZON_SLOPE = 1e-4
"""Lines of sight that fall less than this never meet the ground."""
_ZENITH_SLOPE = 0.45
"""Slope above which the sky has its full colour."""
_STEEPEST, _LEVELS = 0.6, 1 << 12
"""Range and number of slopes that haze and sky are tabulated for."""


@dataclass(frozen=True, slots=True)
class GroundBand:
    """Rows, ``first`` to before ``last``, that see ground at similar distances, and the plan view that they read.

    ``plan`` is 0 fine, 1 middle, 2 coarse; ``samples`` per pixel, vertical, are averaged.
    """

    first: int
    last: int
    plan: int
    samples: int


@dataclass(frozen=True, slots=True)
class Backdrop:
    """Parts of a view, (h, w), that depend only on how the camera stands above the ground.

    ``sky`` is the haze colour below the horizon; ``fade`` the share of haze over the ground, 1 at and above the
    horizon; ``clear`` what haze leaves of it; ``light`` is 255 for white. ``bands`` go from the horizon down, and from
    row ``hazy_until`` on haze is invisible.
    """

    sky: NDArray[np.uint8]
    fade: NDArray[np.float32]
    clear: NDArray[np.float32]
    light: NDArray[np.uint8] | None
    bands: tuple[GroundBand, ...]
    hazy_until: int

    @classmethod
    def of(cls, view: PlacedCamera, air: Atmosphere, ego_yaw: float, ego_xy: Floats) -> "Backdrop":
        """Work out a backdrop. Head lamps follow ``ego_yaw``, radians; ``ego_xy`` is the rear axle, global."""
        height = float(view.eye[2] - view.ground_z)
        x, y, z = view.compute_pixel_rays()
        slope = z / np.sqrt(np.maximum(x * x + y * y, np.float32(1e-12)))
        level = np.clip((slope + _STEEPEST) * (_LEVELS / (2 * _STEEPEST)), 0, _LEVELS).astype(np.int32)
        fade_of, sky_of = _compute_slope_tables(air, height)
        fade, sky = fade_of[level], sky_of[level]
        below = slope < -_HORIZON_SLOPE
        light = _compute_ground_light(view, air, height, ego_yaw, ego_xy)
        bands, hazy_until = _find_bands(height, below, z[:, z.shape[1] // 2], fade)
        return cls(sky, fade, np.asarray(1.0 - fade, np.float32), light, bands, hazy_until)

    def draw(
        self, view: PlacedCamera, plans: tuple[PlanView, PlanView, PlanView], skyline: "Skyline"
    ) -> NDArray[np.uint8]:
        """Picture, (h, w, 3) RGB, of everything that does not stand on the ground: ground, sky and skyline."""
        image = self.sky.copy()
        skyline.draw(image, view)
        if not self.bands:
            return image
        first = self.bands[0].first
        ground = np.empty_like(image[first:])
        from_ground = np.linalg.inv(view.compute_ground_homography())
        to_plans = [np.vstack([plan.world_to_pixel, [0.0, 0.0, 1.0]]) @ from_ground for plan in plans]
        for band in self.bands:
            rows = ground[band.first - first : band.last - first]
            _warp_ground(rows, plans[band.plan].pixels, to_plans[band.plan], band)
        if self.light is not None:
            cv2.multiply(ground, self.light[first:], dst=ground, scale=1.0 / 255.0)
        hazy = slice(first, self.hazy_until)
        share = self.fade[hazy]
        if len(share):
            cv2.blendLinear(ground[: len(share)], image[hazy], self.clear[hazy], share, dst=image[hazy])
        image[self.hazy_until :] = ground[len(share) :]
        return image


def _compute_slope_tables(air: Atmosphere, height: float) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Haze over the ground (n,) and colour of the sky (n, 3) for rising slopes of the line of sight."""
    slope = np.linspace(-_STEEPEST, _STEEPEST, _LEVELS + 1)
    below = slope < -_HORIZON_SLOPE
    fade = np.where(below, air.fade(height / np.maximum(-slope, _HORIZON_SLOPE)), 1.0)
    rise = np.clip(slope / _ZENITH_SLOPE, 0.0, 1.0)[:, None] ** 0.75
    sky = np.array(air.haze) * (1 - rise) + np.array(air.sky) * rise
    return fade.astype(np.float32), np.rint(sky).astype(np.uint8)


def _compute_ground_light(
    view: PlacedCamera, air: Atmosphere, height: float, ego_yaw: float, ego_xy: Floats
) -> NDArray[np.uint8] | None:
    """Light on the ground under each pixel, or ``None`` for plain daylight."""
    if air.tint == (1.0, 1.0, 1.0) and air.beam == 0.0:
        return None
    # Light changes slowly over the picture: every fourth pixel is enough.
    x, y, z = view.compute_pixel_rays(4).astype(np.float64)
    reach = height / np.maximum(-z, 1e-4)
    east, north = view.eye[0] - ego_xy[0] + x * reach, view.eye[1] - ego_xy[1] + y * reach
    cos, sin = np.cos(ego_yaw), np.sin(ego_yaw)
    beam = air.compute_beam(east * cos + north * sin, north * cos - east * sin)
    light = np.clip(255.0 * (np.array(air.tint) + beam[..., None]), 0, 255).astype(np.uint8)
    size = (view.camera.width, view.camera.height)
    return np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)


def _find_bands(
    height: float, below: NDArray[np.bool_], drop: NDArray[np.float32], fade: NDArray[np.float32]
) -> tuple[tuple[GroundBand, ...], int]:
    """Cut the rows that see ground into bands of similar distance, by the middle column and its downward rays."""
    height_px = len(below)
    rows = np.flatnonzero(below.any(axis=1))
    if not len(rows):
        return (), 0
    first = int(rows[0])
    depth = height / np.maximum(-drop.astype(np.float64), 1e-4)
    step = np.abs(np.gradient(depth)) if height_px > 1 else depth
    plan = np.where(depth < FINE_UNTIL_M, 0, np.where(depth < MIDDLE_UNTIL_M, 1, 2))
    texel = np.array([0.05, 0.1, 0.2])[plan]
    wanted = step / (_TEXELS_PER_SAMPLE * texel)
    samples = np.array(_SAMPLES)[np.clip(np.searchsorted(_SAMPLES, wanted), 0, len(_SAMPLES) - 1)]
    bands: list[GroundBand] = []
    start = first
    for row in range(first + 1, height_px + 1):
        if row == height_px or (plan[row], samples[row]) != (plan[start], samples[start]):
            bands.append(GroundBand(start, row, int(plan[start]), int(samples[start])))
            start = row
    visible = np.flatnonzero((fade > 1.0 / 255.0).any(axis=1))
    return tuple(bands), int(max(visible[-1] + 1 if len(visible) else first, first))


def _warp_ground(image: NDArray[np.uint8], plan: NDArray[np.uint8], image_to_plan: Floats, band: GroundBand) -> None:
    # Row r of the finer image looks through row (r + 0.5) / samples - 0.5 of the band.
    rows = np.array(
        [[1.0, 0.0, 0.0], [0.0, 1.0 / band.samples, 0.5 / band.samples - 0.5 + band.first], [0.0, 0.0, 1.0]]
    )
    height, width = image.shape[:2]
    finer = image if band.samples == 1 else np.empty((height * band.samples, width, 3), dtype=np.uint8)
    cv2.warpPerspective(
        plan,
        image_to_plan @ rows,
        (width, len(finer)),
        dst=finer,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    if finer is not image:
        cv2.resize(finer, (width, height), dst=image, interpolation=cv2.INTER_AREA)


@dataclass(frozen=True, slots=True)
class Skyline:
    """Distant blocks around the horizon: (B, 4, 3) directions of corners, fixed to the compass, and (B, 3) RGB."""

    quads: Floats
    colour: Floats

    @classmethod
    def of(cls, location: str, air: Atmosphere) -> "Skyline":
        """The skyline of a place."""
        random = np.random.default_rng(content_seed("skyline", location))
        edges = np.linspace(0.0, 2 * np.pi, _SKYLINE_BLOCKS + 1)
        tops = 0.012 + 0.045 * random.random(_SKYLINE_BLOCKS) ** 2
        shade = 0.80 + 0.14 * random.random(_SKYLINE_BLOCKS)
        cos, sin = np.cos(edges), np.sin(edges)
        low = np.full(_SKYLINE_BLOCKS, -0.004)
        corners = [
            (cos[1:], sin[1:], low),
            (cos[:-1], sin[:-1], low),
            (cos[:-1], sin[:-1], tops),
            (cos[1:], sin[1:], tops),
        ]
        quads = np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)
        return cls(quads, shade[:, None] * np.array(air.haze))

    def draw(self, image: NDArray[np.uint8], view: PlacedCamera) -> None:
        """Draw the part that a view sees, in place."""
        in_camera = self.quads @ view.rotation.T
        ahead = (in_camera[..., 2] > 0.05).all(axis=1)
        pixels = view.to_pixels(in_camera[ahead])
        in_view = (pixels[..., 0].max(axis=1) >= 0) & (pixels[..., 0].min(axis=1) < view.camera.width)
        fixed = np.rint(pixels[in_view] * 16).astype(np.int32)
        for corners, colour in zip(fixed, self.colour[ahead][in_view].tolist()):
            cv2.fillConvexPoly(image, corners, colour, cv2.LINE_AA, 4)
