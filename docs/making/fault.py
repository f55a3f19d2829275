"""The pictures of docs/fault.md, one a rule, from the golden cases of the package: ``python docs/making/fault.py``."""

from pathlib import Path
from typing import Any, Final

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import shapely
from matplotlib.patches import Polygon

from benchmark.extensions.golden_sets.fault import BUILT_IN
from benchmark.extensions.golden_sets.fault.cases import FaultCase, read_cases
from benchmark.fairness.fault_definition import RoadUser
from benchmark.fairness.fault_timing import ContactGeometry
from benchmark.geometry import box_corners, to_local
from benchmark.verification.golden_sets import GoldenFolder

IMAGES: Final = Path(__file__).resolve().parents[1] / "images"
SHOWN: Final = (
    "hits-a-barrier", "stands-in-junction", "reversing-into-ego", "person-on-crossing", "child-runs-out",
    "leaves-the-road", "rear-end-by-other", "into-the-roundabout", "left-turn-across-oncoming", "merge-from-ramp",
    "from-the-stem", "pull-out-from-car-park", "u-turn-in-the-way", "over-the-centre-line", "cut-in-too-late",
    "lane-change-into-neighbour", "passes-a-bicycle-too-near", "line-0.2-over",
)  # fmt: skip
COLOURS: Final = ("#1a7f37", "#e8590c")
"""Of the ego and of the other, as on the site."""
HALF_M: Final = (16.0, 11.0)
LABELLED_M: Final = 3.0
"""Boxes at entry that are nearer to those at the contact are left out."""
SURFACES: Final = {"drivable_area": "#ececec", "walkways": "#d9d2c5", "crossings": "#fff3bf", "carparks": "#dbe4ff"}


def main() -> None:
    """Draw all of them."""
    cases = {case.name: case for case in read_cases(GoldenFolder(BUILT_IN))}
    for name in SHOWN:
        figure, axes = plt.subplots(figsize=(2.9, 2.0))
        draw_case(axes, cases[name])
        figure.savefig(IMAGES / f"fault-{name}.png", dpi=100)
        plt.close(figure)


def draw_case(axes: Any, case: FaultCase) -> None:
    """The ego drives to the right; ways in pale, boxes at the contact in full, those at entry dashed with the time."""
    contact = ContactGeometry(case.tracks)
    frame = np.array([*contact.point, case.tracks.ego.pose[contact.settled, 2]])
    for layer, colour in SURFACES.items():
        for shape in case.surfaces[layer]:
            axes.fill(*to_local(np.array(shape.exterior.coords), frame).T, facecolor=colour)
    for shape, _ in case.stop_lines:
        axes.fill(*to_local(np.array(shape.exterior.coords), frame).T, facecolor="#fa5252")
    for lane in case.lanes or ():
        border = shapely.linestrings(lane.centerline).buffer(lane.width_m / 2, cap_style="flat").exterior.coords
        axes.plot(*to_local(np.array(border), frame).T, color="#bbbbbb", linewidth=0.6)
        axes.plot(*to_local(lane.centerline, frame).T, color="#cccccc", linewidth=0.5, linestyle=":")
    for number, colour in enumerate(COLOURS):
        draw_user(axes, contact, number, frame, colour)
    axes.plot(0.0, 0.0, marker="x", color="black", markersize=6, zorder=5)
    axes.set(xlim=(-HALF_M[0], HALF_M[0]), ylim=(-HALF_M[1], HALF_M[1]), xticks=[], yticks=[])
    axes.set_position([0.0, 0.0, 1.0, 1.0])


def draw_user(axes: Any, contact: ContactGeometry, number: int, frame: Any, colour: str) -> None:
    """The way of one user, its entry into that of the other, and its place at the contact."""
    user: RoadUser = contact.users[number]
    corners = to_local(box_corners(user.boxes()[contact.window :]), frame)
    pieces = np.concatenate([corners[:-1], corners[1:]], axis=1)
    way = shapely.union_all(shapely.convex_hull(shapely.multipoints(pieces)))
    axes.fill(*np.array(way.exterior.coords).T, facecolor=colour, alpha=0.18)
    entered = contact.time_left(number).entry
    entry = corners[entered - contact.window]
    if entered > contact.window and np.hypot(*(entry - corners[-1]).mean(axis=0)) > LABELLED_M:
        axes.add_patch(Polygon(entry, fill=False, edgecolor=colour, linestyle="--", linewidth=1.0))
        seconds = contact.times[-1] - contact.times[entered]
        axes.text(*entry.mean(axis=0), f"{seconds:.1f} s", color=colour, fontsize=7, ha="center", va="center")
    box = to_local(box_corners(user.box_at(contact.poses[number])), frame)
    axes.add_patch(Polygon(box, facecolor=colour, edgecolor="black", linewidth=0.6, zorder=3))
    front = box[[0, 3]].mean(axis=0)
    axes.plot(*np.stack([box.mean(axis=0), front]).T, color="white", linewidth=1.0, zorder=4)


if __name__ == "__main__":
    main()
