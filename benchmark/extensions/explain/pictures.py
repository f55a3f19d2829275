"""Pictures of disagreements for people: what happens beside what a protocol sees."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from benchmark.constants import PLAN_STEP_S
from benchmark.extensions.explain.clearest_cases import (
    DisagreementCase,
    ego_rectangle,
    find_clearest_cases,
    find_contact_instant,
    select_objects,
    waypoint_instant,
)
from benchmark.extensions.explain.views import (
    EGO,
    GHOST,
    HIT,
    IGNORED,
    INK,
    OBJECT,
    build_raster_view,
    draw_cells,
    draw_path,
    fill,
    frame_view,
    outline,
    shade_cells,
)
from benchmark.geometry import Floats, box_corners
from benchmark.machine.storage import sanitise_file_name, write_bytes
from benchmark.metrics.disagreement import CAUSES, COUNTERFACTUALS, MISS, filter_objects, find_contacts_before_mask
from benchmark.protocols import PROTOCOLS, CollisionProtocol
from benchmark.protocols.exact import INSTANTS_PER_STEP, compute_plan_boxes
from benchmark.protocols.stacked_truths import StackedTruths, stack
from benchmark.records.run import RunRecord
from benchmark.report.plots import figure_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from benchmark.datasets.roots import DataSet

HALF_VIEW_M = 7.5
_DPI = 100

WORDS = {
    "miss: between waypoints": "The bodies meet between two waypoints. The protocol checks only every 0.5 s.",
    "miss: class not counted": "The protocol does not count objects of this class: one can drive through them.",
    "miss: not annotated now or since": "The object is not annotated when the plan is made, or not at all times since.",
    "miss: out of range now": "The object is too far away when the plan is made, so the protocol drops it.",
    "miss: no sensor points": "No sensor point was counted on the object, so the protocol ignores it.",
    "miss: heading": "The protocol does not turn the ego as the plan does, so its box is in the wrong place.",
    "miss: raster": "On the protocol's grid the two boxes do not overlap.",
    "miss: mask": "The protocol finds the recorded ego colliding here too, so it drops the collision.",
    "false alarm: heading": "The protocol does not turn the ego as the plan does, so its box reaches too far.",
    "false alarm: raster": "On the protocol's grid the two boxes overlap; in truth there is a gap.",
    "miss: other instants": "Key frames are not half a second apart here: the protocol looks at other instants.",
    "false alarm: other instants": "Key frames are not half a second apart here: the protocol looks at other instants.",
}
"""Every cause in a sentence."""

_REASONS = ("class not counted", "not annotated now or since", "out of range now", "no sensor points")


@dataclass(frozen=True, slots=True)
class CasePicture:
    """Picture of a case as a PNG file, with a sentence about it for a terminal."""

    case: DisagreementCase
    path: Path
    sentence: str


def explain(records: Sequence[RunRecord], data: "DataSet", folder: Path) -> list[CasePicture]:
    """Write a picture of the clearest case of each cause.

    Args:
        records: Run records of any planners on one data set.
        data: The data set that they ran on.
        folder: Where to.

    Returns:
        The pictures, by protocol and cause.

    Raises:
        InputError: If a scene cannot be read or a file cannot be written.
    """
    pictures = []
    for case in find_clearest_cases(records, data):
        cause = case.cause.replace(": ", "-").replace(" ", "-")
        path = folder / f"{sanitise_file_name(case.protocol)}-{sanitise_file_name(cause)}.png"
        write_bytes(path, draw_case(case))
        pictures.append(CasePicture(case, path, describe_case(case)))
    return pictures


def describe_case(case: DisagreementCase) -> str:
    """A case in words: the objects, the place and the fault."""
    kind = "misses a collision of" if case.cause.startswith(MISS) else "reports a collision that is none of"
    return (
        f"{case.protocol} {kind} {case.planner}, {case.truth.scene} sample {case.truth.index}, "
        f"{_time(case.step)} ahead. {WORDS[case.cause]}"
    )


def draw_case(case: DisagreementCase) -> bytes:
    """PNG of a case, always the same bytes: the events on the left, the protocol's view on the right."""
    import matplotlib.style
    from matplotlib.figure import Figure

    # Colours and fonts must not depend on the user's settings.
    with matplotlib.style.context("default", after_reset=True):
        figure = Figure(figsize=(9.0, 5.6), dpi=_DPI, facecolor="white")
        true_axes, protocol_axes = figure.subplots(1, 2)
        instant = _choose_instant(case)
        centre = _find_view_centre(case, instant)
        for axes in (true_axes, protocol_axes):
            frame_view(axes, centre, HALF_VIEW_M)
        _draw_scene(true_axes, case, instant)
        _draw_protocol_view(protocol_axes, case)
        true_axes.set_ylabel("metres ahead of the car now", fontsize=7, color="#777777")
        _write_captions(figure, case)
        return figure_png(figure)


def _find_view_centre(case: DisagreementCase, instant: int) -> Floats:
    """Middle of the view: between where the ego is and where the protocol puts it, which a grid's border parts."""
    centre = compute_plan_boxes(case.plan_lidar)[instant, :2]
    view = build_raster_view(PROTOCOLS[case.protocol], case.truth, case.plan_lidar, case.step)
    return centre if view is None else 0.5 * (centre + view.ego_middle_m)


def _choose_instant(case: DisagreementCase) -> int:
    if case.cause == f"{MISS}: {COUNTERFACTUALS[0]}":
        return find_contact_instant(case.truth, case.plan_lidar, case.step)
    return waypoint_instant(case.step)


def _draw_scene(axes: "Axes", case: DisagreementCase, instant: int) -> None:
    ego = compute_plan_boxes(case.plan_lidar)[instant]
    boxes, numbers = select_objects(case.truth, instant)
    hit = False
    for box, number in zip(boxes, numbers):
        fill(axes, box_corners(box), OBJECT)
        _label_box(axes, box, case.truth.categories[number])
    draw_path(axes, case.plan_lidar)
    fill(axes, box_corners(ego), EGO)
    for box in boxes:
        common = shapely.intersection(shapely.Polygon(box_corners(ego)), shapely.Polygon(box_corners(box)))
        hit |= bool(shapely.Polygon(box_corners(ego)).intersects(shapely.Polygon(box_corners(box))))
        if common.area > 0.0:
            fill(axes, np.array(common.exterior.coords)[:-1], HIT, alpha=0.9)
    _headline(axes, "What happens", hit, f"{(instant + 1) * PLAN_STEP_S / INSTANTS_PER_STEP:.1f} s")


def _draw_protocol_view(axes: "Axes", case: DisagreementCase) -> None:
    definition, stacked = PROTOCOLS[case.protocol], stack([case.truth])
    official = definition.evaluate([case.truth], case.plan_lidar[None])
    between = case.cause == f"{MISS}: {COUNTERFACTUALS[0]}" and case.step > 0
    for step, alpha in ((case.step - 1, 0.35), (case.step, 1.0)) if between else ((case.step, 1.0),):
        _draw_protocol_step(axes, definition, stacked, case, step, alpha)
        if between:
            axes.annotate(_time(step), tuple(case.plan_lidar[step] + [1.1, 0.3]), fontsize=9, color=EGO, clip_on=True)
    masked = bool((find_contacts_before_mask(official) & ~official.collision)[0, case.step])
    if masked:
        _draw_recorded(axes, definition, case)
    _headline(
        axes,
        f"{case.protocol} sees",
        bool(official.collision[0, case.step]),
        f"{_time(case.step - 1)} and {_time(case.step)}" if between else _time(case.step),
        suffix=" (masked)" if masked else "",
    )


def _draw_protocol_step(
    axes: "Axes", definition: CollisionProtocol, stacked: StackedTruths, case: DisagreementCase, step: int, alpha: float
) -> None:
    waypoint = case.plan_lidar[step]
    view = build_raster_view(definition, case.truth, case.plan_lidar, step)
    _draw_objects(axes, definition, stacked, case, step, None if view is not None else alpha)
    if view is None:
        heading = definition.headings(case.plan_lidar[None])[0, step]
        fill(axes, box_corners(ego_rectangle(waypoint, heading)), EGO, alpha=0.75 * alpha)
        draw_path(axes, case.plan_lidar)
    else:
        draw_cells(axes, view, alpha=alpha)
        outline(axes, box_corners(compute_plan_boxes(case.plan_lidar)[waypoint_instant(step)]), EGO, "--")


def _draw_objects(
    axes: "Axes",
    definition: CollisionProtocol,
    stacked: StackedTruths,
    case: DisagreementCase,
    step: int,
    alpha: float | None,
) -> None:
    """Objects that count (outlines only if ``alpha`` is None), and those that do not with the reason."""
    filters = np.stack([counted[:, step] for counted in filter_objects(definition, stacked)])
    for number in np.flatnonzero(stacked.annotated[:, step + 1]).tolist():
        box = stacked.boxes[number, step + 1]
        if filters[-1, number] and alpha is None:
            outline(axes, box_corners(box), INK, "-")
        elif filters[-1, number] and alpha is not None:
            fill(axes, box_corners(box), OBJECT, alpha=0.75 * alpha)
        else:
            outline(axes, box_corners(box), IGNORED, "--")
            reason = _REASONS[int(np.argmin(filters[:, number]))]
            note = f"{_short(stacked.categories[number])}: {reason if case.cause.endswith(reason) else 'not counted'}"
            if case.cause.endswith(reason) and "range" in reason:
                now = stacked.boxes[number, 0, :2]
                note += f"\n(now {abs(now[1]):.0f} m {'ahead' if now[1] > 0 else 'behind'}, {abs(now[0]):.0f} m aside)"
            _write_above(axes, box, note, "#555555")


def _draw_recorded(axes: "Axes", definition: CollisionProtocol, case: DisagreementCase) -> None:
    recorded = case.truth.ego_future[case.step]
    view = build_raster_view(definition, case.truth, case.truth.ego_future[:, :2], case.step)
    if view is not None:
        shade_cells(axes, view, view.ego, GHOST, alpha=0.35)
    heading = definition.headings(case.truth.ego_future[None, :, :2])[0, case.step]
    box = ego_rectangle(recorded[:2], heading if view is None else recorded[2])
    outline(axes, box_corners(box), GHOST, "-")
    _write_above(axes, box, "recorded ego", GHOST)


def _headline(axes: "Axes", who: str, collision: bool, when: str, *, suffix: str = "") -> None:
    verdict = "COLLISION" if collision else "no collision"
    colour = HIT if collision else EGO
    axes.set_title(f"{who} at {when}: {verdict}{suffix}", fontsize=10, color=colour, fontweight="bold")


def _write_captions(figure: "Figure", case: DisagreementCase) -> None:
    kind = "misses a collision" if case.cause.startswith(MISS) else "reports a collision that is none"
    figure.suptitle(f"{case.protocol} {kind}: {case.cause.partition(': ')[2]}", fontsize=12, fontweight="bold", y=0.985)
    figure.text(0.5, 0.915, WORDS[case.cause], ha="center", fontsize=9.5, color=INK)
    figure.text(
        0.5,
        0.015,
        f"green: plan of {case.planner}   ·   {case.truth.scene}, sample {case.truth.index}   ·   dashed grey: not "
        "counted   ·   red: where both are",
        ha="center",
        fontsize=8,
        color="#666666",
    )
    figure.subplots_adjust(left=0.06, right=0.985, top=0.85, bottom=0.115, wspace=0.12)


def _label_box(axes: "Axes", box: Floats, category: str) -> None:
    if category != "vehicle.car":
        _write_above(axes, box, _short(category), INK)


def _write_above(axes: "Axes", box: Floats, text: str, colour: str) -> None:
    """A label above an object, if the object is in view."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    if not (left < box[0] < right and low < box[1] < high):
        return
    middle = 0.5 * (left + right)
    side = "right" if box[0] > middle + 3.0 else "left" if box[0] < middle - 3.0 else "center"
    axes.annotate(
        text,
        (float(box[0]), float(box[1])),
        xytext=(0, 44 if box[1] < high - 4.0 else -44),
        textcoords="offset points",
        arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.7},
        fontsize=8,
        color=colour,
        ha=side,
        va="center",
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
    )


def _short(category: str) -> str:
    known = {"vehicle.car": "car", "movable_object.trafficcone": "cone"}
    return known.get(category, category.rpartition(".")[2] if "bus" not in category else "bus")


def _time(step: int) -> str:
    return f"{(step + 1) * PLAN_STEP_S:.1f} s"


assert set(WORDS) == set(CAUSES)
