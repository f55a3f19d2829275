"""Figures from run records: collision rate over the horizon, disagreement of protocols, who fails which manoeuvre."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from benchmark.constants import HORIZON_STEPS
from benchmark.metrics.disagreement import EXACT, compare_protocols
from benchmark.metrics.effect import find_touched_scenes, knows_contact_partners
from benchmark.metrics.rates import Rate
from benchmark.records.rows import find_scene_failures
from benchmark.records.run import NATIVE, RunRecord, resolve_protocol
from benchmark.records.run_schema import ProtocolSummary
from benchmark.report.canvas import sanitise_name
from benchmark.report.plots import PlotTheme, Sketch, new_figure, render_for_pages
from benchmark.report.words import format_title
from leaderboard.frame.rows import OFF_SCALE, list_splits, name_cell, name_judge
from leaderboard.frame.runs import DataSetRuns, RunRow
from leaderboard.page.sections import NamedFigure

MARKERS: Final = "osD^vPX*"
"""Told apart in print; with the palette's six colours they repeat after 24 planners."""
PANELS: Final = 4
"""Planners beside each other; more go into further lines."""
_PAIRED_INCHES: Final = 5.7
"""Width of figures of which two stand beside each other on a page."""
_LEGEND_COLUMNS: Final = 3
UNLABELLED_MANOEUVRE: Final = "unlabelled"


def run_figures(frame: DataSetRuns) -> list[NamedFigure]:
    """Collision rates over the horizon, manoeuvres, and protocols against ``exact``."""
    drawn = [
        *(
            (
                f"rates-{judge}",
                f"Collision rate over the horizon, {name_judge(judge)}",
                rates_over_horizon(frame, judge),
            )
            for judge in (EXACT, *((NATIVE,) if frame.has_native else ()))
        ),
        ("manoeuvres-exact", "Adversarial scenes failed by manoeuvre, protocol exact", manoeuvre_figure(frame, EXACT)),
        *(
            (f"disagreement-{split}", f"Protocols against exact, split {split}", disagreement_figure(frame, split))
            for split in frame.splits
        ),
    ]
    return [NamedFigure(name, title, *render_for_pages(sketch)) for name, title, sketch in drawn if sketch is not None]


def rates_over_horizon(frame: DataSetRuns, protocol: str) -> Sketch | None:
    """Collision rate at 1, 2 and 3 s of every planner, a panel a split, with 95 % bands; ``None`` without verdicts."""
    rows = frame.judged(protocol)
    return partial(_horizon_figure, frame.data_name, protocol, rows) if rows else None


def disagreement_figure(frame: DataSetRuns, split: str) -> Sketch | None:
    """Share of what ``exact`` sees that each protocol misses, and of its reports that are false, if both judged."""
    runs = [run for run in frame.runs if run.run.split == split and EXACT in run.run.protocols]
    compared_runs = [(run, compare_protocols(run)) for run in runs]
    if not any(compared for _, compared in compared_runs):
        return None
    return partial(_disagreement, frame.data_name, split, compared_runs)


def manoeuvre_figure(frame: DataSetRuns, protocol: str) -> Sketch | None:
    """Adversarial scenes of each manoeuvre, and those in which each planner hits the adversary first.

    Where records do not say whom contacts are with: how many it fails. ``None`` where no record of split ``adv`` has
    manoeuvres.
    """
    runs = [
        run
        for run in frame.runs
        if run.run.split == "adv" and resolve_protocol(run, protocol) in run.run.protocols and _find_manoeuvres(run)
    ]
    return partial(_manoeuvre_panels, frame.data_name, protocol, runs) if runs else None


def _horizon_figure(data_name: str, protocol: str, rows: Sequence[RunRow[ProtocolSummary]], theme: PlotTheme) -> Figure:
    runs = [row.record for row in rows]
    splits = list_splits(runs)
    planners = list(dict.fromkeys(run.planner for run in runs))
    names_of = {run.planner: planner_name(run) for run in runs}
    style = {name: planner_style(place, theme) for place, name in enumerate(planners)}
    lines_of_legend = -(-len(planners) // _LEGEND_COLUMNS)
    below = 0.15 + 0.2 * lines_of_legend
    figure = new_figure(max(_PAIRED_INCHES, 0.8 + 1.9 * len(splits)), 2.9 + below)
    panels = figure.subplots(1, len(splits), sharey=True, squeeze=False)[0]
    for axes, split in zip(panels, splits):
        for row in rows:
            if row.split == split:
                _draw_band(axes, row.found.columns["collision"], style[row.record.planner])
        axes.set_title(sanitise_name(split), parse_math=False)
        axes.set_xticks([float(name.removesuffix("s")) for name in HORIZON_STEPS], list(HORIZON_STEPS))
        axes.grid(axis="y", color=theme.rule, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("collision rate (%)")
    # Panels share this axis.
    top, most = (max(_list_ends(rows, on_scale=scale), default=0.0) for scale in (True, False))
    panels[0].set_ylim(0, 1.05 * top if top else None)
    lines = [mpl.lines.Line2D([], [], **style[name]) for name in planners]
    names = [f"{names_of[name]}{' (off scale)' * (name == OFF_SCALE and 0.0 < top < most)}" for name in planners]
    figure.tight_layout(rect=(0, below / figure.get_figheight(), 1, 0.93))
    label_below(figure, lines, names, _LEGEND_COLUMNS, columnspacing=1.2)
    _write_heading(figure, f"{sanitise_name(data_name)}: collision rate over the horizon, {name_judge(protocol)}")
    return figure


def _list_ends(rows: Sequence[RunRow[ProtocolSummary]], *, on_scale: bool) -> Iterator[float]:
    """Rates and upper ends of their intervals in per cent, of all planners but `OFF_SCALE`, or of that one alone."""
    for row in rows:
        if (row.record.planner != OFF_SCALE) == on_scale:
            rates = [row.found.columns["collision"][horizon] for horizon in HORIZON_STEPS]
            yield from (100 * end for rate in rates for end in (rate.value, rate.high) if end is not None)


def _draw_band(axes: Axes, rates: Mapping[str, Rate], style: dict[str, Any]) -> None:
    drawn = [
        (float(horizon.removesuffix("s")), rates[horizon])
        for horizon in HORIZON_STEPS
        if rates[horizon].value is not None
    ]
    if not drawn:
        return
    seconds = [at for at, _ in drawn]
    axes.plot(seconds, [100 * (rate.value or 0.0) for _, rate in drawn], **style)
    if all(rate.low is not None and rate.high is not None for _, rate in drawn):
        low, high = (
            [100 * (end or 0.0) for end in ends] for ends in zip(*((rate.low, rate.high) for _, rate in drawn))
        )
        axes.fill_between(seconds, low, high, color=style["color"], alpha=0.12, linewidth=0)


def _disagreement(
    data_name: str, split: str, compared_runs: Sequence[tuple[RunRecord, dict[str, Any]]], theme: PlotTheme
) -> Figure:
    protocols = list(dict.fromkeys(name for _, compared in compared_runs for name in compared))
    figure = new_figure(
        _PAIRED_INCHES, 1.3 + (0.3 + 0.09 * len(compared_runs)) * len(protocols) + 0.11 * len(compared_runs)
    )
    panels = figure.subplots(1, 2, sharey=True)
    height = 0.8 / len(compared_runs)
    for place, (_, compared) in enumerate(compared_runs):
        for row, protocol in enumerate(protocols):
            if protocol not in compared:
                continue
            samples = compared[protocol].samples
            at = row - 0.4 + height * (place + 0.5)
            for axes, share in zip(panels, (samples.missed_share, samples.false_share)):
                if share is None:
                    axes.plot(0.0, at, marker="|", color=theme.planner(place), markersize=5)
                else:
                    axes.barh(at, 100 * share, height * 0.9, color=theme.planner(place))
    for axes, title in zip(panels, ("missed, % of collisions by exact", "false, % of reported collisions")):
        axes.set_xlim(0, 100)
        axes.set_title(title, fontsize="medium")
        axes.grid(axis="x", color=theme.rule, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(range(len(protocols)), [sanitise_name(name) for name in protocols], parse_math=False)
    panels[0].set_ylim(len(protocols) - 0.5, -0.5)
    figure.tight_layout(rect=(0, (0.1 + 0.22 * -(-len(compared_runs) // 2)) / figure.get_figheight(), 1, 0.92))
    patches = [Patch(color=theme.planner(place)) for place in range(len(compared_runs))]
    names = [planner_name(run) for run, _ in compared_runs]
    label_below(figure, patches, names, 2)
    _write_heading(
        figure, f"{sanitise_name(format_title(data_name, split))}: protocols against exact (a tick: undefined)"
    )
    return figure


def _manoeuvre_panels(data_name: str, protocol: str, runs: Sequence[RunRecord], theme: PlotTheme) -> Figure:
    total = Counter(name for run in runs for name in _find_manoeuvres(run).values())
    order = sorted(total, key=lambda name: (-total[name], name))
    lines = -(-len(runs) // PANELS)
    figure = new_figure(2.2 + 2.3 * min(len(runs), PANELS), 0.5 + (0.8 + 0.3 * len(order)) * lines)
    whom = all(knows_contact_partners(run, resolve_protocol(run, protocol)) for run in runs)
    grid = figure.subplots(lines, min(len(runs), PANELS), sharey=True, sharex=True, squeeze=False)
    panels = list(grid.flat)
    for axes in panels[len(runs) :]:
        axes.set_axis_off()
    for axes, run in zip(panels, runs):
        manoeuvres, judge = _find_manoeuvres(run), resolve_protocol(run, protocol)
        failures = find_touched_scenes(run, judge) if whom else find_scene_failures(run.rows, judge)
        decided = [scene for scene, fails in failures.items() if fails is not None and scene in manoeuvres]
        scenes = Counter(manoeuvres[scene] for scene in decided)
        failed = Counter(manoeuvres[scene] for scene, fails in failures.items() if fails and scene in manoeuvres)
        rows = range(len(order))
        axes.barh(rows, [scenes[name] for name in order], 0.72, color=theme.good)
        axes.barh(rows, [failed[name] for name in order], 0.72, color=theme.contact)
        for row, name in enumerate(order):
            axes.text(scenes[name], row, f" {failed[name]}/{scenes[name]}", va="center", fontsize="small")
        name = planner_name(run)
        axes.set_title(name, fontsize="medium", parse_math=False)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xlabel("scenes")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    panels[0].set_xlim(0, 1.25 * max(total[name] / len(runs) for name in order) + 1)
    panels[0].set_yticks(range(len(order)), [sanitise_name(name) for name in order], parse_math=False)
    panels[0].set_ylim(len(order) - 0.5, -0.5)
    figure.tight_layout(rect=(0, 0, 1, 0.93))
    subject = "scenes in which the adversary is hit first" if whom else "adversarial scenes failed"
    _write_heading(figure, f"{sanitise_name(data_name)}: {subject} (red), {name_judge(protocol)}")
    return figure


def _find_manoeuvres(run: RunRecord) -> dict[str, str]:
    """Manoeuvre of the adversary of each scene; empty where the record says nothing of any."""
    facts = run.run.scene_facts
    manoeuvre_of_scene = {scene: facts[scene].manoeuvre for scene in run.run.scenes if scene in facts}
    if not any(manoeuvre_of_scene.values()):
        return {}
    return {scene: name or UNLABELLED_MANOEUVRE for scene, name in manoeuvre_of_scene.items()}


def planner_style(place: int, theme: PlotTheme) -> dict[str, Any]:
    """Style of the line of the planner at a place."""
    marker = MARKERS[(place + place // len(theme.planners)) % len(MARKERS)]
    return {"color": theme.planner(place), "marker": marker, "markersize": 4.5, "linewidth": 1.4}


def _write_heading(figure: Figure, text: str) -> None:
    figure.text(0.5, 0.98, text, ha="center", va="top", fontsize=10.5, parse_math=False)


def label_below(figure: Figure, drawn: Sequence[Any], names: Sequence[str], columns: int, **place: Any) -> None:
    """Say below the panels what is whose; names of strangers are text, not formulas."""
    look = {"loc": "lower center", "ncols": columns, "frameon": False, "fontsize": "small", **place}
    for text in figure.legend(drawn, names, **look).get_texts():
        text.set_parse_math(False)


def planner_name(run: RunRecord) -> str:
    """The planner's name with its marks, as pictures can show it."""
    return sanitise_name(name_cell(run.planner, run.run.planner).text)
