"""What settings of the search win and what they pay for it, in one picture: attack success against valid motion.

``bench/threat.py --figure FILE`` draws it of its rows. On our own town there is no realism of recordings to compare
with; the share of scenes whose adversary has no fault stands in for it, as in the leaderboard's figure.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmark.metrics.rates import Rate, ratios_over_scenes
from benchmark.report.plots import LIGHT, new_figure, picture

_WIDTH, _HEIGHT = 7.2, 3.9
READINGS: Final = {"contact": "any contact", "attributable": "attributable"}
"""What stands on the two upright axes; `docs/severity.md` defines both."""


@dataclass(frozen=True, slots=True)
class Point:
    """One setting: shares of its kept scenes, with intervals over recorded scenes.

    Attributes:
        label: Of the setting.
        valid: Whose adversary has no fault.
        success: By reading.
        kept: How many scenes.
        tried: Of how many vehicles.
    """

    label: str
    valid: Rate
    success: Mapping[str, Rate]
    kept: int
    tried: int


def points(rows: Sequence[dict[str, Any]]) -> list[Point]:
    """A point for each setting that kept anything, its seeds together, in the order of the rows."""
    found = []
    for label in dict.fromkeys(row["setting"] for row in rows):
        mine = [row for row in rows if row["setting"] == label]
        scenes = [each for row in mine for each in row["each"]]
        if scenes:
            said = np.array(
                [
                    [not each["faults"], each["colliding"] > 0, each["at_fault"] and each["careful_survives"]]
                    for each in scenes
                ],
                dtype=np.float64,
            )
            recorded = [each["scene"].rsplit("-", 1)[0] for each in scenes]
            valid, contact, attributable = ratios_over_scenes(said, np.ones_like(said), recorded, seed=0)
            success = {"contact": contact, "attributable": attributable}
            found.append(Point(label, valid, success, len(scenes), sum(row["tried"] for row in mine)))
    return found


def write_figure(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the points of rows of one data set to a PNG or SVG file."""
    path.write_bytes(picture(lambda _: _figure(points(rows)), path.suffix))


def _figure(shown: Sequence[Point]) -> Figure:
    figure = new_figure(_WIDTH, _HEIGHT)
    panels = figure.subplots(1, len(READINGS), sharex=True, sharey=True)
    for axes, (reading, head) in zip(panels, READINGS.items(), strict=True):
        axes.set_title(head, fontsize="medium")
        axes.set_xlabel("scenes whose adversary has no fault, %")
        axes.set(xlim=(-4, 104), ylim=(-4, 104))
        axes.grid(color=LIGHT.rule, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        for number, point in enumerate(shown):
            _draw(axes, point, reading, number)
    panels[0].set_ylabel("constant-velocity fails, % of kept scenes")
    figure.tight_layout(rect=(0, 0.05 + 0.05 * -(-len(shown) // 2), 1, 1))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=2, frameon=False, fontsize="small")
    return figure


def _draw(axes: Axes, point: Point, reading: str, number: int) -> None:
    """A point with its interval upright; its number beside it."""
    rate, colour = point.success[reading], LIGHT.planner(number)
    at, value = 100.0 * (point.valid.value or 0.0), 100.0 * (rate.value or 0.0)
    if rate.low is not None and rate.high is not None:
        axes.plot([at, at], [100.0 * rate.low, 100.0 * rate.high], color=colour, linewidth=1.2, alpha=0.4)
    label = f"{number + 1}  {point.label}: {point.kept} of {point.tried} kept"
    axes.plot(at, value, marker="o", linestyle="none", markersize=6, color=colour, label=label)
    axes.annotate(str(number + 1), (at, value), xytext=(5, 4), textcoords="offset points", fontsize="small")
