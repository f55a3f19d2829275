"""Pictures of what UniAD reports: tracks, forecasts, occupancy, road map and plan from above, boxes in the images.

```python
planner = UniADPlanner.from_checkpoint("uniad", Path("uniad_base_e2e.pth"), masks=True)
write_pictures(planner, data.scene("scene-0061"), data.observations("scene-0061"), Path("pictures"))
```
"""

from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from adapters.camera_inputs import ImageFormat, lidar_to_image
from adapters.detection_classes import AGENT_CLASSES
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.frames import UniADOutputs
from adapters.networks.uniad.occupancy import CELL_M
from adapters.networks.uniad.planner import UniADPlanner
from adapters.planner import FORECAST_SCORE, numbers
from benchmark.constants import CAMERA_NAMES
from benchmark.geometry import Floats, box_corners
from benchmark.machine.storage import file_name, write_bytes
from benchmark.planning import Observation, SceneInfo
from benchmark.protocols.explain.clearest_cases import ego_rectangle
from benchmark.protocols.explain.views import EGO, GHOST, INK, fill, frame_view, outline, png
from benchmark.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HALF_VIEW_M: Final = 42.0
TRACK_COLOURS: Final = ("#0077b6", "#c1440e", "#7b2cbf", "#2d6a4f", "#b5179e", "#6c584c", "#d00000", "#4361ee")
"""Tracks keep theirs from frame to frame."""
ROAD_COLOURS: Final = ("#f4a259", "#5b8e7d", "#8cb369")
"""Of dividers, crossings and borders."""
DRIVABLE, OCCUPIED = "#eef0f3", "#e5383b"
NEAREST_DEPTH_M: Final = 0.5
"""Boxes that reach closer to a camera's plane are not drawn in its image."""
IMAGE_COLUMNS: Final = 400
"""About as many pixels of an image's width are shown."""
IMAGE_ROWS: Final = (
    ("CAM_FRONT", "CAM_BACK"),
    ("CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"),
    ("CAM_BACK_LEFT", "CAM_BACK_RIGHT"),
)
_EDGES: Final = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
_DPI: Final = 90


def write_pictures(
    planner: UniADPlanner, scene: Scene, observations: Iterable[Observation], folder: Path, limit: int | None = None
) -> list[Path]:
    """Drive a scene and draw every sample of it.

    Args:
        planner: Its past is forgotten; with `UniAD.masks` the road map is in the pictures.
        scene: The scene.
        observations: Its samples in the order of time.
        folder: Where to.
        limit: How many samples.

    Returns:
        PNG files, ``SCENE-INDEX.png``.

    Raises:
        InputError: If an image is missing or broken, or a file cannot be written.
    """
    planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
    written = []
    for observation in islice(observations, limit):
        planner.plan(observation)
        if planner.seen is not None:
            path = folder / f"{file_name(scene.name)}-{observation.index:02d}.png"
            write_bytes(path, draw_frame(observation, planner.seen, planner.config))
            written.append(path)
    return written


def draw_frame(observation: Observation, seen: UniADOutputs, config: UniADConfig) -> bytes:
    """Draw one sample.

    Args:
        observation: What was seen.
        seen: What the network made of it.
        config: Of the network.

    Returns:
        A PNG file; the same sample gives the same bytes.
    """
    import matplotlib.style
    from matplotlib.figure import Figure

    # Colours and fonts must not depend on the user's settings.
    with matplotlib.style.context("default", after_reset=True):
        figure = Figure(figsize=(16.0, 7.6), dpi=_DPI, facecolor="white", layout="constrained")
        places = figure.add_gridspec(3, 3, width_ratios=(2.0, 1.0, 1.0))
        _draw_from_above(figure.add_subplot(places[:, 0]), seen, config)
        for row, names in enumerate(IMAGE_ROWS):
            for column, name in enumerate(names, 1):
                _draw_image(figure.add_subplot(places[row, column]), observation, name, seen)
        figure.suptitle(
            f"{observation.scene}, sample {observation.index}, command {observation.command.name.lower()}: "
            f"{len(seen.box_scores)} tracks",
            fontsize=11,
        )
        return png(figure)


def _draw_from_above(axes: "Axes", seen: UniADOutputs, config: UniADConfig) -> None:
    frame_view(axes, np.zeros(2), min(HALF_VIEW_M, config.perception_range_m[3]))
    axes.set_ylabel("metres ahead of the car now", fontsize=7, color="#777777")
    if seen.road is not None:
        x_low, y_low, _, x_high, y_high, _ = config.perception_range_m
        extent = (x_low, x_high, y_low, y_high)
        _shade(axes, seen.road.drivable.cpu().numpy(), extent, DRIVABLE, 1.0)
        for mask, colour in zip(seen.road.lanes.cpu().numpy(), ROAD_COLOURS):
            _shade(axes, mask, extent, colour, 0.8)
    occupied = seen.occupied.cpu().numpy()
    half = occupied.shape[1] * CELL_M / 2
    for step in range(len(occupied) - 1, -1, -1):
        _shade(axes, occupied[step], (-half, half, -half, half), OCCUPIED, 0.55 if step == 0 else 0.15)
    for row, box, ident, colour in _tracks(seen):
        outline(axes, box_corners(box[[0, 1, 4, 3, 6]]), colour, "-")
        axes.annotate(str(ident), (box[0], box[1]), fontsize=7, color=colour, ha="center", va="center", clip_on=True)
        shares = numbers(seen.trajectory_scores[row])
        for path, share in zip(numbers(seen.trajectories[row]), shares, strict=True):
            if share >= 1 / len(shares):
                drawn = np.concatenate([box[None, :2], path])
                axes.plot(drawn[:, 0], drawn[:, 1], "-", color=colour, linewidth=1.0, alpha=float(share) ** 0.5)
    fill(axes, box_corners(ego_rectangle(np.zeros(2), np.pi / 2)), EGO, alpha=0.4)
    if seen.collision is not None:
        before = np.concatenate([np.zeros((1, 2)), numbers(seen.plan_before_optimisation)])
        axes.plot(before[:, 0], before[:, 1], "--x", color=GHOST, linewidth=1.2, markersize=4)
    after = np.concatenate([np.zeros((1, 2)), numbers(seen.plan)])
    axes.plot(after[:, 0], after[:, 1], "-o", color=EGO, linewidth=2.2, markersize=4.5, markeredgecolor="white")
    moved = "not optimised" if seen.collision is None else f"dashed before {seen.collision.solver}"
    axes.set_title(f"plan ({moved}); red: occupied now, pale: in the next 2 s", fontsize=9, color=INK)


def _draw_image(axes: "Axes", observation: Observation, name: str, seen: UniADOutputs) -> None:
    view = observation.views[name]
    step = max(view.camera.width // IMAGE_COLUMNS, 1)
    image = view.load()[::step, ::step]
    axes.imshow(image, extent=(0, view.camera.width, view.camera.height, 0), interpolation="nearest")
    axes.set_xlim(0, view.camera.width)
    axes.set_ylim(view.camera.height, 0)
    axes.set_axis_off()
    axes.set_title(name.removeprefix("CAM_").replace("_", " ").lower(), fontsize=8, pad=2)
    recorded = ImageFormat(view.camera.width, view.camera.height)
    projection = lidar_to_image(observation, recorded)[CAMERA_NAMES.index(name)]
    for row, box, ident, colour in _tracks(seen):
        u_v_depth = np.column_stack([_corners(box), np.ones(8)]) @ projection[:3].T
        if u_v_depth[:, 2].min() < NEAREST_DEPTH_M:
            continue
        pixels = u_v_depth[:, :2] / u_v_depth[:, 2:]
        if ((pixels < 0) | (pixels > [view.camera.width, view.camera.height])).any(1).all():
            continue
        for edge in _EDGES:
            axes.plot(pixels[list(edge), 0], pixels[list(edge), 1], "-", color=colour, linewidth=0.8)
        label = AGENT_CLASSES[int(seen.box_labels[row]) % len(AGENT_CLASSES)]
        axes.annotate(f"{ident} {label}", tuple(pixels.min(0)), fontsize=6, color=colour, clip_on=True)


def _tracks(seen: UniADOutputs) -> list[tuple[int, Floats, int, str]]:
    """Rows, (9,) boxes, numbers and colours of the tracks that are drawn, most certain first."""
    boxes, scores, idents = numbers(seen.boxes), numbers(seen.box_scores), seen.track_ids.cpu().tolist()
    sound = np.isfinite(boxes).all(1) & (scores >= FORECAST_SCORE)
    return [
        (row, boxes[row], idents[row], TRACK_COLOURS[idents[row] % len(TRACK_COLOURS)])
        for row in np.flatnonzero(sound).tolist()
    ]


def _corners(box: Floats) -> Floats:
    """(8, 3) of a (9,) box whose centre is that of its volume; the lower four first."""
    ground = box_corners(box[[0, 1, 4, 3, 6]])
    return np.concatenate([np.column_stack([ground, np.full(4, box[2] + side * box[5] / 2)]) for side in (-1, 1)])


def _shade(axes: "Axes", mask: Floats, extent: tuple[float, float, float, float], colour: str, alpha: float) -> None:
    """Cells of a (rows, columns) mask, rows from the least y."""
    from matplotlib.colors import to_rgba

    shown = np.zeros((*mask.shape, 4))
    shown[mask.astype(bool)] = to_rgba(colour, alpha)
    axes.imshow(shown, origin="lower", extent=extent, interpolation="nearest", zorder=0.5)
    axes.set_autoscale_on(False)
