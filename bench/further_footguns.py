"""Pictures of docs/footguns.md for the protocols of other papers: cases of causes, and the kerb."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from benchmark.constants import PLAN_STEP_S
from benchmark.extensions.explain.views import EGO, HIT, INK, draw_path, fill, frame_view
from benchmark.geometry import Floats, box_corners
from benchmark.protocols import Outcomes
from benchmark.protocols.exact import ego_boxes
from benchmark.truth import SampleTruth

FROM_FURTHER_CAUSES = {
    "stp3-warp": ("stp3", "false alarm: raster"),
    "bev-planner-holes": ("bev-planner", "false alarm: raster"),
    "omnidrive-holes": ("omnidrive", "false alarm: raster"),
    "opendrivevla-rear": ("opendrivevla", "false alarm: raster"),
    "safemvdrive-no-mask": ("safemvdrive", "false alarm: raster"),
    "safemvdrive-box-heading": ("safemvdrive-box", "false alarm: heading"),
    "agent-driver-stp3-range": ("agent-driver-stp3", "miss: out of range now"),
}
"""Picture to protocol and cause: the clearest case on adv, of constant-velocity if it has one."""
ROAD = "#e3e6ea"
_HALF_VIEW_M = 11.0


def draw_kerb(figure: Figure, truths: Sequence[SampleTruth], plans: Floats, outcomes: dict[str, Outcomes]) -> None:
    """A plan that leaves the road: beyond the kerb no kerb is touched, and it is off the road all the same.

    Args:
        figure: Where to draw.
        truths: S samples with roads.
        plans: (S, 6, 2) waypoints of the lidar origin, metres.
        outcomes: Verdicts on them by protocol.
    """
    kerb = outcomes["bev-planner"].step("kerb_before_mask").astype(np.bool_)
    off = outcomes["omnidrive"].step("off_road").astype(np.bool_)
    # The last steps beyond the kerb, none of them on it.
    beyond = (off[:, -2:].all(axis=1) & ~kerb[:, -2:].any(axis=1)).nonzero()[0].tolist()
    row = max(beyond, key=lambda index: (not kerb[index].any(), off[index].sum(), -index))
    truth, plan = truths[row], plans[row]
    assert truth.roads is not None
    axes = figure.subplots()
    boxes = ego_boxes(plan)[4::5]
    frame_view(axes, boxes[3:].mean(axis=0)[:2], _HALF_VIEW_M)
    ahead, left = np.nonzero(truth.roads.drivable_cells().T)
    x, y = _in_lidar(np.column_stack([ahead, left]) * 0.1 - 50.0, truth.lidar_ahead_m).T
    axes.plot(x, y, ",", color=ROAD, zorder=0)
    for line in truth.roads.kerb_lines():
        axes.plot(*_in_lidar(line, truth.lidar_ahead_m).T, ".-", color=INK, markersize=4, linewidth=1.0)
    for step, box in enumerate(boxes):
        fill(axes, box_corners(box), HIT if kerb[row, step] else EGO, alpha=0.6)
        time = f"{PLAN_STEP_S * (step + 1):.1f} s" + (", off the road" if off[row, step] else "")
        axes.annotate(time, box[:2] + [1.3, 0.0], fontsize=8, annotation_clip=True)
    draw_path(axes, plan)
    axes.set_title(
        "Off the road for OmniDrive; for BEV-Planner contact\nwith the kerb (red) only while on the line",
        fontsize=11,
        fontweight="bold",
    )


def _in_lidar(points: Floats, ahead_m: float) -> Floats:
    """(N, 2) x forward, y left of the rear axle as x right, y forward of the lidar."""
    return np.column_stack([-points[:, 1], points[:, 0] - ahead_m])
