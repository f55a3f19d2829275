"""One round of refinement on the map: the road, who is where, and the candidates by their score."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LogNorm
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path
from matplotlib.patheffects import withStroke

from benchmark.geometry import Floats, box_corners, to_local
from benchmark.records.scene_pages import ScenePage, TraceFrame
from benchmark.report.ground import build_ground
from benchmark.report.palette import ADVERSARY, EGO, GroundColours, Rgb
from benchmark.report.placement import agent_box, ego_box
from benchmark.report.plots import PlotTheme

FRAMES_AHEAD: Final = 36
"""Of the ego's recorded way: 3 s, as candidates are drawn."""
_MARGIN_M, _LEAST_WIDTH_M, _MOST_WIDTH_M = 4.0, 26.0, 120.0
_NO_SCORE: Final = "#777777"


@dataclass(frozen=True, slots=True)
class MapView:
    """View of the panels: the adversary drives to the right from (0, 0).

    `pose` is (3,) in the sheet's metres; the edges are metres in its frame, `left` behind it, `bottom` to its right.
    """

    pose: Floats
    left: float
    right: float
    bottom: float
    top: float

    def here(self, points: Floats) -> Floats:
        """Points (..., 2) of the sheet in the adversary's frame."""
        return to_local(np.asarray(points, dtype=np.float64), self.pose)


def compute_view(sheet: ScenePage, agent_id: str, at: TraceFrame, shape: float) -> MapView:
    """The part of the map, of a shape of width by height, that holds all candidates and, where it is near, the ego."""
    lines = [np.array(line) for entry in at.rounds for line in entry.candidates if line]
    boxes = (agent_box(agent, at.frame) for agent in sheet.agents if agent.id == agent_id)
    box = next((candidate for candidate in boxes if candidate is not None), None)
    pose = np.array([*lines[0][0], 0.0 if box is None else box[4]])
    points = to_local(np.concatenate(lines), pose)
    ego = to_local(_find_ego_path(sheet, at.frame)[:1], pose)
    near = np.hypot(*ego.T) < _MOST_WIDTH_M / 2
    points = np.vstack([points, ego[near]])
    low, high = points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M
    wanted = max(high[0] - low[0], (high[1] - low[1]) * shape)
    half = float(np.clip(wanted, _LEAST_WIDTH_M, _MOST_WIDTH_M)) / 2
    x, y = ((low + high) / 2).tolist()
    return MapView(pose, x - half, x + half, y - half / shape, y + half / shape)


def draw_road(axes: Axes, sheet: ScenePage, view: MapView, colours: GroundColours) -> None:
    """Draw the map of a sheet."""
    axes.set_facecolor(to_rgb(colours.land))
    window = shapely.box(view.left - 1, view.bottom - 1, view.right + 1, view.top + 1)
    ground = build_ground(sheet, colours)
    for layer in (ground.below, ground.drivable, *ground.above):
        for area in layer.areas:
            rings = [view.here(ring) for ring in area if len(ring) > 3]
            if rings:
                visible = shapely.make_valid(shapely.Polygon(rings[0], rings[1:])).intersection(window)
                _fill_area(axes, visible, to_rgb(layer.colour))
    for line in sheet.road.dividers:
        name = next((kind for kind in colours.paint if line.paint.endswith(f"-{kind}")), None)
        if name is None or len(line.points) < 2:
            continue
        visible = shapely.LineString(view.here(np.array(line.points))).intersection(window)
        pattern = (0, (5, 4)) if line.paint.startswith("dashed") else "solid"
        paths = [shapely.get_coordinates(part) for part in shapely.get_parts(visible)]
        axes.add_collection(
            LineCollection(paths, colors=[to_rgb(colours.paint[name])], linewidths=1.0, linestyles=[pattern], zorder=1)
        )


def draw_traffic(axes: Axes, sheet: ScenePage, agent_id: str, frame: int, view: MapView, theme: PlotTheme) -> None:
    """Draw who is where at a planning frame, and the ego's recorded way from there."""
    for agent in sheet.agents:
        box = agent_box(agent, frame)
        if box is not None:
            own = agent.id == agent_id
            _draw_box(axes, box, view, ADVERSARY if own else theme.ground.vehicle, "A" if own else "", theme.paper)
    way = view.here(_find_ego_path(sheet, frame))
    if len(way):
        axes.plot(*way.T, color=theme.paper, linewidth=3.2, zorder=4)
        axes.plot(*way.T, color=to_rgb(EGO), linewidth=1.8, linestyle=(0, (3, 1.5)), zorder=4)
        axes.plot(*way[-1], marker="o", markersize=4, color=to_rgb(EGO), markeredgecolor=theme.paper, zorder=4)
        _draw_box(axes, ego_box(sheet, frame), view, EGO, "E", theme.paper)


def draw_candidates(
    axes: Axes, at: TraceFrame, number: int, view: MapView, scale: LogNorm, colours: Colormap, theme: PlotTheme
) -> None:
    """Draw the candidates of one round, the better over the worse, and the executed one if it is of this round."""
    entry = at.rounds[number]
    scores = np.array([np.inf if score is None else score for score in entry.scores])
    order = [index for index in np.argsort(scores, kind="stable")[::-1] if len(entry.candidates[index]) > 1]
    paths = [view.here(np.array(entry.candidates[index])) for index in order]
    tints = [_NO_SCORE if np.isinf(scores[index]) else colours(scale(scores[index])) for index in order]
    axes.add_collection(LineCollection(paths, colors=tints, linewidths=1.0, zorder=3))
    if paths:
        ends = np.array([path[-1] for path in paths])
        axes.scatter(ends[:, 0], ends[:, 1], s=5, c=tints, linewidths=0, zorder=3)
    if number == at.chosen_round and at.chosen < len(entry.candidates):
        path = view.here(np.array(entry.candidates[at.chosen]))
        for colour, width in ((theme.paper, 5.0), (theme.ink, 3.2)):
            axes.plot(*path.T, color=colour, linewidth=width, zorder=5, solid_capstyle="round")
        axes.plot(*path[-1], marker="*", markersize=13, color=theme.paper, markeredgecolor=theme.ink, zorder=8)


def to_rgb(colour: Rgb) -> tuple[float, float, float]:
    """A colour as Matplotlib takes it."""
    red, green, blue = colour
    return red / 255, green / 255, blue / 255


def _find_ego_path(sheet: ScenePage, frame: int) -> Floats:
    """(F, 2) centres of the ego's body from a frame on; none where the sheet has no such frame."""
    frames = range(frame, min(frame + FRAMES_AHEAD + 1, len(sheet.ego.x_m)))
    return np.array([ego_box(sheet, frame_number)[:2] for frame_number in frames]).reshape(-1, 2)


def _fill_area(axes: Axes, area: shapely.Geometry, colour: tuple[float, ...]) -> None:
    for part in shapely.get_parts(area):
        if part.geom_type == "MultiPolygon":
            _fill_area(axes, part, colour)
        elif part.geom_type == "Polygon":
            rings = (part.exterior, *part.interiors)
            outline = Path.make_compound_path(*(Path(shapely.get_coordinates(ring), closed=True) for ring in rings))
            # Seams between neighbouring areas of one road would show without an edge of the same colour.
            axes.add_patch(PathPatch(outline, facecolor=colour, edgecolor=colour, linewidth=0.4, zorder=0.5))


def _draw_box(axes: Axes, box: Floats, view: MapView, colour: Rgb, letter: str, edge: str) -> None:
    corners = view.here(box_corners(box))
    low, high = corners.min(axis=0), corners.max(axis=0)
    if high[0] < view.left or low[0] > view.right or high[1] < view.bottom or low[1] > view.top:
        return
    axes.add_patch(Polygon(corners, facecolor=to_rgb(colour), edgecolor=edge, linewidth=0.8, zorder=2))
    if letter:
        x, y = view.here(box[:2])
        outline = withStroke(linewidth=2.0, foreground=to_rgb(colour))
        style: dict[str, Any] = {
            "ha": "center",
            "va": "center",
            "fontsize": 8.5,
            "fontweight": "bold",
            "color": "white",
        }
        axes.text(x, y, letter, zorder=7, clip_on=True, path_effects=[outline], **style)
