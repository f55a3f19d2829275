"""Pictures of contacts from above: both ways, where each came into the other's and when, on the lanes of the map."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from benchmark.fairness.fault_definition import ContactTracks, FaultAttribution, RoadUser, UserFacts
from benchmark.fairness.fault_roads import FaultRoads
from benchmark.fairness.fault_timing import ContactGeometry
from benchmark.geometry import Floats, box_corners, to_local
from benchmark.report.fault_words import spell_reason

COLOURS: Final = ("#1a7f37", "#e8590c")
"""Of the ego and of the other, as on the site."""
_LABELLED_M: Final = 3.0
"""Boxes at entry that are nearer to those at the contact are left out."""
_SURFACES: Final = {"drivable_area": "#ececec", "walkways": "#d9d2c5", "crossings": "#fff3bf", "carparks": "#dbe4ff"}
_PICTURE_M: Final = (36.0, 24.0)


def write_contact_picture(
    path: Path, tracks: ContactTracks, roads: FaultRoads, fault: FaultAttribution, title: str
) -> None:
    """Write a picture of a contact as PNG, with its verdict, reason and times; the ego drives to the right."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.6))
    axes = figure.add_axes((0.0, 0.0, 1.0, 0.86))
    draw_contact(axes, ContactGeometry(tracks.to_first_touch()), roads, _PICTURE_M)
    whose = {"ego": "the ego's fault", "other": "the other's fault", "shared": "both users' fault"}
    told = f"{whose.get(fault.verdict, 'fault unclear')}: {spell_reason(fault.reason)} (fault@1)"
    figure.text(0.012, 0.965, title, fontsize=9, va="center")
    figure.text(0.012, 0.925, told, fontsize=11, va="center", weight="bold")
    for number, (name, facts) in enumerate((("ego", fault.ego), ("other", fault.other))):
        words = f"{name}: {_describe_entry(facts)}"
        figure.text(0.012 + 0.49 * number, 0.885, words, fontsize=9, va="center", color=COLOURS[number])
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100, metadata={"Software": None})


def _describe_entry(facts: UserFacts) -> str:
    entered = "always in the way" if facts.entry_s is None else f"came in {facts.entry_s:.1f} s before"
    if np.isinf(facts.time_left_s):
        left = "the other needed no time"
    else:
        left = f"left {facts.time_left_s:.1f} s ({facts.time_was})"
    home = {"lane": "from its lane", "against": "from the oncoming lane", "off": "from beside the lanes"}
    return ", ".join([entered, left, *([home[facts.home]] if facts.home else [])])


def draw_contact(axes: Any, contact: ContactGeometry, roads: FaultRoads, half_m: tuple[float, float]) -> None:
    """Draw on axes of matplotlib: ways in pale, boxes at the contact in full, those at entry dashed with the time."""
    frame = np.array([*contact.point, contact.users[0].pose[contact.settled, 2]])
    for layer, colour in _SURFACES.items():
        for shape in shapely.get_parts(getattr(roads, layer)) if getattr(roads, layer) is not None else ():
            rings = [shape.exterior, *shape.interiors]
            for ring, filled in zip(rings, [colour, *["white"] * len(shape.interiors)], strict=True):
                axes.fill(*to_local(np.array(ring.coords), frame).T, facecolor=filled)
    for lane in roads.lanes:
        strip = lane.polygon or shapely.linestrings(lane.centerline).buffer(lane.width_m / 2, cap_style="flat")
        for part in shapely.get_parts(strip):
            axes.plot(*to_local(np.array(part.exterior.coords), frame).T, color="#bbbbbb", linewidth=0.6)
        axes.plot(*to_local(lane.centerline, frame).T, color="#cccccc", linewidth=0.5, linestyle=":")
    for shape in roads.sign_shapes:
        axes.fill(*to_local(np.array(shape.exterior.coords), frame).T, facecolor="#fa5252")
    for number, colour in enumerate(COLOURS):
        _draw_user(axes, contact, number, frame, colour)
    axes.plot(0.0, 0.0, marker="x", color="black", markersize=6, zorder=5)
    axes.set(xlim=(-half_m[0], half_m[0]), ylim=(-half_m[1], half_m[1]), xticks=[], yticks=[])


def _draw_user(axes: Any, contact: ContactGeometry, number: int, frame: Floats, colour: str) -> None:
    from matplotlib.patches import Polygon

    user: RoadUser = contact.users[number]
    corners = to_local(box_corners(user.boxes()[contact.window :]), frame)
    pieces = np.concatenate([corners[:-1], corners[1:]], axis=1) if len(corners) > 1 else corners
    way = shapely.union_all(shapely.convex_hull(shapely.multipoints(pieces)))
    for part in shapely.get_parts(way):
        axes.fill(*np.array(part.exterior.coords).T, facecolor=colour, alpha=0.18)
    entered = contact.time_left(number).entry
    entry = corners[entered - contact.window]
    if entered > contact.window and np.hypot(*(entry - corners[-1]).mean(axis=0)) > _LABELLED_M:
        axes.add_patch(Polygon(entry, fill=False, edgecolor=colour, linestyle="--", linewidth=1.0))
        seconds = contact.times[-1] - contact.times[entered]
        axes.text(*entry.mean(axis=0), f"{seconds:.1f} s", color=colour, fontsize=7, ha="center", va="center")
    box = to_local(box_corners(user.box_at(contact.poses[number])), frame)
    axes.add_patch(Polygon(box, facecolor=colour, edgecolor="black", linewidth=0.6, zorder=3))
    front = box[[0, 3]].mean(axis=0)
    axes.plot(*np.stack([box.mean(axis=0), front]).T, color="white", linewidth=1.0, zorder=4)
