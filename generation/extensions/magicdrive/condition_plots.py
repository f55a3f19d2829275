"""Plots of MagicDriveDiT's conditions: visibility, map, cameras, ego motion, time and words."""

import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.constants import (
    DETECTION_CLASSES,
    EGO_BODY_WIDTH_M,
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_LENGTH_M,
    LIDAR_FROM_REAR_AXLE_M,
)
from benchmark.geometry import Floats, box_corners
from benchmark.report.palette import ADVERSARY, EGO, format_hexadecimal
from benchmark.report.plots import figure_png
from generation.extensions.magicdrive.bev_map import MAP_CHANNELS, MAP_EXTENT_M
from generation.extensions.magicdrive.clip import Clip, group_latent_frames
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS
from generation.extensions.magicdrive.sensor_frames import CALIBRATION_SIZE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

CLASS_COLOURS: Final[dict[str, tuple[int, int, int]]] = {
    "car": (70, 160, 255),
    "truck": (60, 200, 190),
    "construction_vehicle": (150, 190, 60),
    "bus": (30, 120, 220),
    "trailer": (120, 150, 220),
    "barrier": (190, 150, 110),
    "motorcycle": (200, 110, 220),
    "bicycle": (240, 120, 190),
    "pedestrian": (120, 235, 120),
    "traffic_cone": (255, 220, 70),
}
"""RGB by class of object."""
_ADVERSARY: Final = format_hexadecimal(ADVERSARY)
_INK, _PALE = "#26282c", "#9aa0a8"
_DPI: Final = 100
_FLOOR: Final = (0, 4, 7, 3)
_SLOT_ROWS: Final = 34


def draw_visibility(clip: Clip, place: int, adversaries: Sequence[int]) -> bytes:
    """PNG from above, by view: boxes that it is told to use are filled, others outlined; ``adversaries`` are slots."""

    def draw(figure: "Figure") -> None:
        for view, axes in enumerate(figure.subplots(2, 3).ravel()):
            _draw_plan(axes, 60.0)
            _draw_wedge(axes, clip, view, place, 60.0)
            _draw_floors(axes, clip, place, adversaries, clip.boxes.masks[view, place])
            box_count = int(clip.boxes.masks[view, place].sum())
            axes.set_title(
                f"{view} {MODEL_CAMERAS[view]}: {box_count} of {int(clip.boxes.present[place].sum())}", fontsize=9
            )

    return _draw_figure(
        (10.5, 7.2), draw, f"{clip.scene}, frame {clip.frames[place]}: boxes used by each view (lidar frame)"
    )


def draw_map(clip: Clip, place: int, adversaries: Sequence[int]) -> bytes:
    """PNG of the map channels of the frame at position ``place`` in the clip, with the boxes on them."""

    def draw(figure: "Figure") -> None:
        extent = (-MAP_EXTENT_M, MAP_EXTENT_M, -MAP_EXTENT_M, MAP_EXTENT_M)
        for channel, axes in enumerate(figure.subplots(2, 4).ravel()):
            _draw_plan(axes, MAP_EXTENT_M)
            mask = clip.maps[place, channel]
            axes.imshow(mask.T, origin="lower", extent=extent, cmap="Greys", vmin=0, vmax=1.6, interpolation="nearest")
            _draw_floors(axes, clip, place, adversaries, None)
            axes.set_title(f"{channel} {MAP_CHANNELS[channel]}: {100 * mask.mean():.1f} %", fontsize=9)

    headline = f"{clip.scene}, frame {clip.frames[place]}: map from above, metres right and ahead of the lidar"
    return _draw_figure((13.0, 7.2), draw, headline)


def draw_cameras(clip: Clip) -> bytes:
    """PNG of where the six cameras of the first frame stand and look, and of their intrinsic numbers."""

    def draw(figure: "Figure") -> None:
        plan, table = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
        _draw_plan(plan, 4.0)
        lines = [f"{'view':<20}{'fx':>8}{'fy':>8}{'cx':>8}{'cy':>8}   x, y, z in the lidar frame (m)"]
        for view, name in enumerate(MODEL_CAMERAS):
            _draw_wedge(plan, clip, view, 0, 3.0)
            camera = clip.cams[view, 0]
            plan.annotate(
                f"{view} {name}", tuple(camera[:2, 6] + 1.6 * _compute_direction(camera)), fontsize=8, ha="center"
            )
            numbers = (camera[0, 0], camera[1, 1], camera[0, 2], camera[1, 2])
            at = ", ".join(f"{value:+.2f}" for value in camera[:, 6])
            lines.append(f"{view} {name:<18}" + "".join(f"{value:8.0f}" for value in numbers) + f"   {at}")
        table.axis("off")
        table.text(0.0, 0.9, "\n".join(lines), family="monospace", fontsize=8, va="top")

    return _draw_figure((13.0, 5.6), draw, f"{clip.scene}: cameras as input (first frame; pixels of 1600 x 900 images)")


def draw_ego_motion(clip: Clip, keyframes: "NDArray[np.int64]") -> bytes:
    """PNG of the way of the lidar in its first frame, and of the length of each step."""
    way = np.linalg.inv(clip.rel_pos.astype(np.float64))[:, :2, 3]
    key = np.isin(clip.frames, keyframes)

    def draw(figure: "Figure") -> None:
        path, steps = figure.subplots(1, 2)
        # A car that stands still is shown on metres too, not on millionths of them.
        path.scatter(*(way.mean(axis=0) + np.array([[-2.0, -2.0], [2.0, 2.0]])).T, alpha=0.0)
        path.plot(*way.T, "-", color=_PALE, linewidth=1)
        path.plot(*way[key].T, "o", color=_INK, markersize=3)
        path.set_aspect("equal", adjustable="datalim")
        path.set_xlabel("metres to the right")
        path.set_ylabel("metres ahead; dots are keyframes")
        lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
        colours = [_ADVERSARY if into else _PALE for into in key[1:]]
        steps.bar(np.arange(1, len(way)), lengths, width=1.0, color=colours)
        steps.set_ylim(0.0, max(1.1 * lengths.max(initial=0.0), 0.1))
        steps.set_xlabel("position in the clip (red: step into a keyframe)")
        steps.set_ylabel("metres from the frame before")

    return _draw_figure((11.0, 4.8), draw, f"{clip.scene}: ego motion as given to the model")


def draw_pooling(clip: Clip, keyframes: "NDArray[np.int64]", adversaries: Sequence[int]) -> bytes:
    """PNG of when each object is there, and which frames share a latent frame; ``adversaries`` are slots."""
    from matplotlib.patches import Patch

    groups = group_latent_frames(len(clip.frames))
    classes = clip.boxes.classes.T
    rgb = np.array([*(CLASS_COLOURS[name] for name in DETECTION_CLASSES), (255, 255, 255)], np.float64)[classes] / 255.0

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        count, slots = len(clip.frames), len(classes)
        axes.imshow(rgb, aspect="auto", interpolation="nearest", extent=(-0.5, count - 0.5, slots - 0.5, -0.5))
        for latent, group in enumerate(groups):
            shade = _PALE if latent % 2 else _INK
            axes.barh(-1.6, len(group), left=group[0] - 0.5, height=1.2, color=shade)
            axes.axvline(group[0] - 0.5, color="black", linewidth=0.25, alpha=0.5)
        repeated = np.append(False, np.diff(clip.frames) == 0)
        key = np.flatnonzero(np.isin(clip.frames, keyframes) & ~repeated)
        axes.plot(key, np.full(len(key), -2.8), "v", color=_ADVERSARY, markersize=3)
        axes.set_ylim(slots - 0.5, -3.6)
        if repeated.any():
            axes.axvspan(float(repeated.argmax()) - 0.5, count - 0.5, facecolor="none", edgecolor=_PALE, hatch="//")
        axes.set_xlabel("position in the clip; bars: latent frames; triangles: keyframes; hatched: last frame repeated")
        axes.set_ylabel("box slot")
        for slot in adversaries:
            axes.axhline(slot, color=_ADVERSARY, linewidth=1.5, linestyle=":")
        present = [DETECTION_CLASSES[number] for number in np.unique(classes[classes >= 0])]
        patches = [Patch(color=format_hexadecimal(CLASS_COLOURS[name]), label=name) for name in present]
        axes.legend(handles=patches, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)

    sizes = f"{len(clip.frames)} frames become {len(groups)} latent frames (the first of {len(groups[0])})"
    return _draw_figure((13.0, 2.2 + 0.09 * len(classes)), draw, f"{clip.scene}: {sizes}")


def draw_words(clip: Clip, adversaries: Sequence[int]) -> bytes:
    """PNG of the prompt, the numbers and the objects; ``adversaries`` are slots marked as such."""
    kinds = [DETECTION_CLASSES[int(number)] for number in clip.boxes.classes.max(axis=0) if number >= 0]
    counts = ", ".join(f"{count} {name}" for name, count in Counter(kinds).most_common()) or "none"
    lines = [
        *textwrap.wrap(f"prompt: {clip.prompt.positive}", 100),
        *textwrap.wrap(f"negative prompt: {clip.prompt.negative or '(the null prompt of the model)'}", 100),
        f"fps {clip.fps:g}, {clip.height} x {clip.width} pixels, frames {len(clip.frames)}",
        f"objects: {counts}",
        "",
    ]
    rows = [
        f"{slot:3d} {name[:32]:<33}{kinds[slot]}{' ADVERSARY' if slot in adversaries else ''}"
        for slot, name in enumerate(clip.boxes.ids)
    ]
    columns = [rows[start : start + _SLOT_ROWS] for start in range(0, len(rows), _SLOT_ROWS)]
    height = 0.5 + 0.16 * len(lines) + 0.14 * min(len(rows), _SLOT_ROWS)

    def draw(figure: "Figure") -> None:
        figure.text(0.02, 1.0 - 0.35 / height, "\n".join(lines), family="monospace", fontsize=9, va="top")
        for number, column in enumerate(columns):
            left = 0.02 + number * 0.96 / max(len(columns), 2)
            below = 1.0 - (0.4 + 0.16 * len(lines)) / height
            figure.text(left, below, "\n".join(column), family="monospace", fontsize=7, va="top")

    return _draw_figure((6.0 * max(len(columns), 2), height), draw, clip.scene)


def _draw_figure(size: tuple[float, float], draw: Callable[["Figure"], None], headline: str) -> bytes:
    import matplotlib.style
    from matplotlib.figure import Figure

    # Colours and fonts must not depend on the user's settings.
    with matplotlib.style.context("default", after_reset=True):
        figure = Figure(figsize=size, dpi=_DPI, facecolor="white", layout="tight")
        figure.suptitle(headline, fontsize=10)
        draw(figure)
        return figure_png(figure)


def _draw_plan(axes: "Axes", extent_m: float) -> None:
    """An empty plane around the lidar, x to the right and y ahead, with the ego's body on it."""
    axes.set_xlim(-extent_m, extent_m)
    axes.set_ylim(-extent_m, extent_m)
    axes.set_aspect("equal")
    axes.set_xticks([-extent_m, 0.0, extent_m])
    axes.set_yticks([-extent_m, 0.0, extent_m])
    axes.tick_params(labelsize=6)
    ahead = EGO_CENTER_FROM_REAR_AXLE_M - LIDAR_FROM_REAR_AXLE_M
    body = box_corners(np.array([0.0, ahead, EGO_LENGTH_M, EGO_BODY_WIDTH_M, np.pi / 2]))
    axes.fill(*body.T, facecolor=f"{format_hexadecimal(EGO)}40", edgecolor=format_hexadecimal(EGO), zorder=3)


def _draw_floors(
    axes: "Axes", clip: Clip, place: int, adversaries: Sequence[int], filled: "NDArray[np.int64] | None"
) -> None:
    """Floors of the boxes with a tick to the front."""
    from matplotlib.collections import LineCollection, PolyCollection

    slots = np.flatnonzero(clip.boxes.present[place]).tolist()
    if not slots:
        return
    floors = clip.boxes.true_corners[place, slots][:, list(_FLOOR), :2]
    colours = [_choose_colour(clip, place, slot, adversaries) for slot in slots]
    used = [filled is None or bool(filled[slot]) for slot in slots]
    faces = [colour if use else "none" for colour, use in zip(colours, used)]
    edges = [_INK if use else _PALE for use in used]
    axes.add_collection(PolyCollection(list(floors), facecolors=faces, edgecolors=edges, linewidths=0.6, zorder=4))
    noses = np.stack([floors.mean(axis=1), floors[:, :2].mean(axis=1)], axis=1)
    axes.add_collection(LineCollection(list(noses), colors=_INK, linewidths=0.6, zorder=5))


def _choose_colour(clip: Clip, place: int, slot: int, adversaries: Sequence[int]) -> str:
    if slot in adversaries:
        return _ADVERSARY
    return format_hexadecimal(CLASS_COLOURS[DETECTION_CLASSES[int(clip.boxes.classes[place, slot])]])


def _draw_wedge(axes: "Axes", clip: Clip, view: int, place: int, length_m: float) -> None:
    """Field of view of a camera, as a triangle from above."""
    camera = clip.cams[view, place].astype(np.float64)
    edges = np.array([[-camera[0, 2], 0.0, camera[0, 0]], [CALIBRATION_SIZE[0] - camera[0, 2], 0.0, camera[0, 0]]])
    rays = (edges / np.linalg.norm(edges, axis=1, keepdims=True)) @ camera[:, 3:6].T
    corners = np.vstack([camera[:2, 6], camera[:2, 6] + length_m * rays[:, :2]])
    axes.fill(*corners.T, facecolor="#8fa3b8", edgecolor="#5f7388", alpha=0.25, linewidth=0.8, zorder=2)


def _compute_direction(camera: "NDArray[np.float32]") -> Floats:
    """(2,) horizontal direction in which a camera looks, lidar frame."""
    ahead = camera[:2, 5].astype(np.float64)
    return np.asarray(ahead / np.linalg.norm(ahead))
