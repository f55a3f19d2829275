"""The pictures and numbers of docs/footguns.md, from the baselines on the embedded data set and a frozen split of it.

The split is `mini-adv-1`, whose scenes were searched before the ground-truth checks of the protocols were asked for: it
shows what a mask does. Both data sets are built where they are missing.
"""

import argparse
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.style
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from adapters.registry import planner_factory
from bench.further_footguns import FROM_FURTHER_CAUSES, draw_kerb
from benchmark.constants import COMMAND_LATERAL_M, PLAN_STEP_S, PLAN_STEPS
from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.extensions.explain.clearest_cases import Case, case_of, clearest_cases, plan_in_lidar
from benchmark.extensions.explain.pictures import draw_case
from benchmark.extensions.explain.views import (
    EGO,
    GHOST,
    HIT,
    IGNORED,
    INK,
    OBJECT,
    draw_path,
    fill,
    frame_view,
    outline,
    png,
)
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.machine.storage import content_seed, write_bytes
from benchmark.machine.workspace import EMBEDDED, cache_root
from benchmark.protocols import PROTOCOLS, Outcomes
from benchmark.protocols.exact import ego_boxes
from benchmark.records.run import RunRecord
from benchmark.truth import SampleTruth
from generation.pipeline.settings import BuildSettings
from generation.sources.mini import TownSettings, build_town
from generation.splits.building import build_frozen
from generation.splits.packaged import frozen_split

PLANNERS = ("constant-velocity", "ego-status", "idm", "log-replay")
COLOURS = 48
SPLIT = "mini-adv-1"

OBJ_COL_LOOKS = np.array([-25.1, 25.1])
"""Where VAD's obj_col looks, from a waypoint: to the right and ahead, metres."""

FROM_CAUSES = {
    "raster-false-alarm": ("uniad", "false alarm: raster"),
    "raster-miss": ("uniad", "miss: raster"),
    "heading": ("uniad", "miss: heading"),
    "pedestrian": ("uniad", "miss: class not counted"),
    "range": ("vad", "miss: out of range now"),
    "appears": ("vad", "miss: not annotated now or since"),
    "category-table": ("vad-23", "miss: class not counted"),
    "points": ("sparsedrive", "miss: no sensor points"),
    "between": ("sparsedrive", "miss: between waypoints"),
    "mask": ("uniad", "miss: mask"),
}
"""Picture to protocol and cause: the clearest case on adv, of constant-velocity if it has one."""


@dataclass(frozen=True, slots=True)
class Runs:
    """Baselines on one split.

    Attributes:
        data: The split's data set.
        records: Run records by planner.
        truths: What really happened, by sample token.
    """

    data: DataSet
    records: dict[str, RunRecord]
    truths: dict[str, SampleTruth]

    def judged(self, planner: str) -> tuple[list[SampleTruth], Floats, dict[str, Outcomes]]:
        """Samples, plans and verdicts of a baseline."""
        rows = self.records[planner].rows
        truths = [self.truths[row.sample_token] for row in rows]
        plans = np.array([plan_in_lidar(row, truth) for row, truth in zip(rows, truths)])
        return truths, plans, {name: one.evaluate(truths, plans) for name, one in PROTOCOLS.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    settings = TownSettings()
    root = build_town(cache_root() / settings.folder_name(EMBEDDED), settings, workers=2)
    source = open_data(root, name=EMBEDDED)
    built = BuildSettings(out=options.out / SPLIT, renderer=None, frames="keyframes")
    print(build_frozen(source, frozen_split(SPLIT), built).summary())
    splits = {"val": source, "adv": open_data(built.out, name=EMBEDDED)}
    run_root = options.out / "runs"
    runs = {split: baselines(data, split, run_root) for split, data in splits.items()}
    print_numbers(runs)
    for name, picture in {**case_pictures(runs["adv"]), **other_pictures(runs)}.items():
        path = options.images / f"footguns-{name}.png"
        write_bytes(path, with_few_colours(picture))
        print(f"{path.stat().st_size:7d} {path}")


def baselines(data: DataSet, split: str, run_root: Path) -> Runs:
    judges = EvalSettings(protocols=tuple(PROTOCOLS))
    records = {name: evaluate(data, split, planner_factory(name), run_root, judges) for name in PLANNERS}
    truths = {truth.sample_token: truth for scene in data.scene_names(split) for truth in data.truth(scene)}
    return Runs(data, records, truths)


def case_pictures(runs: Runs) -> dict[str, bytes]:
    # Plans that do not turn show everything but the heading best.
    found = {
        (case.protocol, case.cause): case
        for records in (list(runs.records.values()), [runs.records["constant-velocity"]])
        for case in clearest_cases(records, runs.data)
    }
    wanted = FROM_CAUSES | FROM_FURTHER_CAUSES
    pictures = {name: draw_case(found[key]) for name, key in wanted.items()}
    return {**pictures, "jitter": draw_case(jittered(runs)), "border": draw_case(beyond_the_border(runs))}


def jittered(runs: Runs) -> Case:
    """The recorded path of a standing car with 0.3 m of noise, where that turns the box into somebody."""
    cases = []
    for truth in runs.truths.values():
        if truth.complete and np.hypot(*truth.ego_future[-1, :2]) < 0.5:
            rng = np.random.default_rng(content_seed("jitter", truth.sample_token))
            for _ in range(40):
                plan = truth.ego_future[:, :2] + rng.normal(0.0, 0.3, (PLAN_STEPS, 2))
                case = case_of("a standing car + 0.3 m of jitter", "sparsedrive", truth, plan)
                cases += [] if case is None or case.cause != "false alarm: heading" else [case]
    return max(cases, key=lambda case: case.clearness)


def beyond_the_border(runs: Runs) -> Case:
    """Straight past somebody at the grid's far edge, where the edge squashes the ego onto them."""
    cases = []
    for truth in runs.truths.values():
        for box in truth.boxes[truth.annotated[:, -1], -1]:
            if truth.complete and 48.5 < box[1] < 50.5 and abs(box[0]) < 20.0:
                plan = np.linspace([0.0, 0.0], [box[0], 56.5], PLAN_STEPS + 1)[1:]
                case = case_of("someone driving at 19 m/s", "uniad", truth, plan)
                if case is not None and case.cause == "false alarm: raster" and case.step == PLAN_STEPS - 1:
                    cases.append(case)
    return max(cases, key=lambda case: case.clearness)


def other_pictures(runs: dict[str, Runs]) -> dict[str, bytes]:
    drawn: dict[str, Callable[[Figure], None]] = {
        "averaging": lambda figure: draw_averaging(figure, runs["adv"]),
        "dilution": lambda figure: draw_dilution(figure, runs["adv"]),
        "forgotten": lambda figure: draw_forgotten(figure, runs["adv"]),
        "obj-col": lambda figure: draw_obj_col(figure, list(runs.values())),
        "command": lambda figure: draw_command(figure, runs["val"]),
        "kerb": lambda figure: draw_kerb(figure, *runs["adv"].judged("constant-velocity")),
    }
    pictures = {}
    for name, draw in drawn.items():
        with matplotlib.style.context("default", after_reset=True):
            figure = Figure(figsize=(6.4, 4.6), dpi=100, facecolor="white", layout="constrained")
            draw(figure)
            pictures[name] = png(figure)
    return pictures


def draw_averaging(figure: Figure, runs: Runs) -> None:
    """One set of verdicts, three ways to print it."""
    _, _, outcomes = runs.judged("constant-velocity")
    verdicts = outcomes["sparsedrive"].collision[outcomes["sparsedrive"].counted]
    seconds = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
    at = 100 * verdicts.mean(axis=0)
    upto = np.cumsum(at) / np.arange(1, PLAN_STEPS + 1)
    ever = 100 * np.logical_or.accumulate(verdicts, axis=1).mean(axis=0)
    axes = figure.subplots()
    for values, label, colour, above in (
        (ever, "any collision up to then (exact)", HIT, 7),
        (at, "value at that step (UniAD)", OBJECT, -15),
        (upto, "mean over the steps up to then (VAD, SparseDrive)", EGO, -15),
    ):
        axes.plot(seconds, values, "o-", color=colour, label=label)
        for index in (3, 5):
            axes.annotate(
                f"{values[index]:.1f}", (seconds[index], values[index]), xytext=(0, above), textcoords="offset points"
            )
    axes.set_xlim(0.3, 3.3)
    axes.set_ylim(-1.5, 1.1 * float(ever[-1]))
    axes.set_xlabel("seconds ahead")
    axes.set_ylabel("collision rate, %")
    axes.set_title("The same verdicts on the same plans, averaged in three ways", fontsize=11, fontweight="bold")
    axes.legend(fontsize=9)


def draw_dilution(figure: Figure, runs: Runs) -> None:
    """The scene of the baseline with most contacts near its end: what is counted as clean."""
    truths, _, outcomes = runs.judged("constant-velocity")
    scenes = np.array([truth.scene for truth in truths])
    valid, contact = outcomes["uniad"].valid, outcomes["uniad"].collision
    late = {scene: int(contact[scenes == scene][-12:].sum()) for scene in sorted(set(scenes.tolist()))}
    scene = max(late, key=lambda name: late[name])
    mine = scenes == scene
    shown = np.where(~valid[mine], 0, np.where(contact[mine], 2, 1))
    axes = figure.subplots()
    for kind, colour, label in (
        (1, "#cfe8d8", "no collision"),
        (2, HIT, "collision"),
        (0, INK, "not recorded: counted as no collision"),
    ):
        sample, step = np.nonzero(shown == kind)
        axes.scatter(sample, PLAN_STEP_S * (step + 1), marker="s", s=46, color=colour, label=label)
    axes.set_xlabel(f"sample of {scene}")
    axes.set_ylabel("seconds ahead")
    axes.set_ylim(0.2, 3.3)
    axes.set_title("The end of a scene has no future of 3 s:\nUniAD counts it as clean", fontsize=11, fontweight="bold")
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)


def forgotten(outcomes: Outcomes) -> Bools:
    """Samples that collide, but at none of the steps that UniAD's table quotes."""
    return np.asarray(outcomes.collision.any(axis=1) & ~outcomes.collision[:, 1::2].any(axis=1))


def draw_forgotten(figure: Figure, runs: Runs) -> None:
    """A plan that drives through somebody and is clean at 1, 2 and 3 s."""
    truths, plans, outcomes = runs.judged("constant-velocity")
    contact = outcomes["uniad"].collision
    rows = np.flatnonzero(forgotten(outcomes["uniad"]) & outcomes["exact"].step("waypoint_collision").any(axis=1))
    row = max(rows.tolist(), key=lambda index: (contact[index, 2:].any(), contact[index].sum(), -index))
    step = int(np.argmax(contact[row]))
    axes = figure.subplots()
    boxes = ego_boxes(plans[row])[4::5]
    frame_view(axes, boxes[2:].mean(axis=0)[:2], 12.0)
    truth = truths[row]
    for box in truth.boxes[truth.annotated[:, step + 1], step + 1]:
        fill(axes, box_corners(box), OBJECT)
    for index, box in enumerate(boxes):
        fill(axes, box_corners(box), HIT if contact[row, index] else EGO, alpha=0.55)
        axes.annotate(f"{PLAN_STEP_S * (index + 1):.1f} s", box[:2] + [1.3, 0.0], fontsize=8, annotation_clip=True)
    axes.set_title(
        f"Through a car at {PLAN_STEP_S * (step + 1):.1f} s (red), clean at 1, 2 and 3 s:\nUniAD's table says 0, 0, 0",
        fontsize=11,
        fontweight="bold",
    )


def flagged_elsewhere(runs: Sequence[Runs]) -> tuple[SampleTruth, Floats, int]:
    """A plan and a step at which VAD's obj_col reports a contact and no box touches; made up if no baseline has one."""
    for one in runs:
        for planner in PLANNERS:
            truths, plans, outcomes = one.judged(planner)
            row, step = _first_flagged(outcomes["vad"])
            if row is not None:
                return truths[row], plans[row], step
    vad = PROTOCOLS["vad"]
    for one in runs:
        for truth in one.truths.values():
            if truth.complete and len(truth.boxes):
                plans = np.linspace(0.0, truth.boxes[:, -1, :2] - OBJ_COL_LOOKS, PLAN_STEPS + 1)[1:].swapaxes(0, 1)
                row, step = _first_flagged(vad.evaluate([truth] * len(plans), plans))
                if row is not None:
                    return truth, plans[row], step
    raise InputError("no plan shows what VAD's obj_col looks at; take another split")


def _first_flagged(outcomes: Outcomes) -> tuple[int | None, int]:
    flagged = outcomes.step("obj_col").astype(np.bool_) & ~outcomes.step("before_mask").astype(np.bool_)
    rows, steps = np.nonzero(flagged & outcomes.counted[:, None])
    return (int(rows[0]), int(steps[0])) if len(rows) else (None, 0)


def draw_obj_col(figure: Figure, runs: Sequence[Runs]) -> None:
    """Where VAD's obj_col looks."""
    truth, plan, step = flagged_elsewhere(runs)
    waypoint = plan[step]
    looked_at = waypoint + OBJ_COL_LOOKS
    axes = figure.subplots()
    frame_view(axes, 0.5 * (waypoint + looked_at), 19.0)
    for box in truth.boxes[truth.annotated[:, step + 1], step + 1]:
        fill(axes, box_corners(box), OBJECT)
    draw_path(axes, plan)
    fill(axes, box_corners(ego_boxes(plan)[5 * step + 4]), EGO)
    axes.annotate("", looked_at, waypoint, arrowprops={"arrowstyle": "->", "color": HIT, "linewidth": 1.6})
    axes.plot(*looked_at, "s", color=HIT, markersize=6)
    axes.annotate("obj_col looks here", looked_at, xytext=(16, 4), textcoords="offset points", color=HIT, fontsize=9)
    axes.set_title(
        "VAD's obj_col reports a collision:\n25 m ahead and 25 m to the left of the car", fontsize=11, fontweight="bold"
    )


def draw_command(figure: Figure, runs: Runs) -> None:
    """A car that drives straight on now, and a command that knows what it will do."""
    ready = [
        truth
        for truth in runs.truths.values()
        if truth.complete and abs(truth.ego_future[1, 0]) < 0.1 and abs(truth.ego_future[-1, 0]) > COMMAND_LATERAL_M
    ]
    truth = max(ready, key=lambda one: (abs(one.ego_future[-1, 0]), one.sample_token))
    future = truth.ego_future[:, :2]
    axes = figure.subplots()
    frame_view(axes, np.array([0.0, 0.5 * future[-1, 1]]), 0.62 * float(future[-1, 1]))
    low, high = axes.get_ylim()
    axes.fill_betweenx([low, high], -COMMAND_LATERAL_M, COMMAND_LATERAL_M, color="#eef0f3", zorder=0)
    for side in (-1.0, 1.0):
        axes.plot([side * COMMAND_LATERAL_M] * 2, [low, high], ":", color=IGNORED)
    fill(axes, box_corners(np.array([0.0, 0.5, 4.084, 1.85, np.pi / 2])), EGO)
    draw_path(axes, future, GHOST)
    outline(axes, box_corners(ego_boxes(future)[-1]), GHOST, "-")
    name = truth.command.name.lower()
    axes.set_title(
        f"The command now is “{name}”: it is read from where\nthe recorded car will be in 3 s",
        fontsize=11,
        fontweight="bold",
    )
    axes.annotate("straight within ±2 m", (0.0, high - 1.0), ha="center", fontsize=8, color="#555555")


def print_numbers(runs: dict[str, Runs]) -> None:
    for split, one in runs.items():
        for planner in PLANNERS:
            truths, _, outcomes = one.judged(planner)
            uniad, vad, exact = outcomes["uniad"], outcomes["vad"], outcomes["exact"]
            whole = uniad.valid.all(axis=1)
            print(
                f"{split} {planner}: {len(truths)} samples, {int(whole.sum())} complete | "
                f"UniAD at 3 s {100 * uniad.collision[:, 5].mean():.2f} of all, "
                f"{100 * uniad.collision[whole, 5].mean():.2f} of complete, "
                f"{100 * uniad.step('before_mask')[whole, 5].mean():.2f} of these before the mask | "
                f"L2 at 3 s {uniad.l2[:, 5].mean():.2f} of all, {uniad.l2[whole, 5].mean():.2f} of complete | "
                f"colliding but not at 1, 2, 3 s {int(forgotten(uniad)[whole].sum())} of "
                f"{int(uniad.collision[whole].any(axis=1).sum())} | "
                f"recorded ego flagged: "
                + ", ".join(
                    f"{name} {int(outcomes[name].step('recorded')[whole].sum())}"
                    for name in ("uniad", "vad", "vad-23", "sparsedrive")
                )
                + f" of {6 * int(whole.sum())} steps | VAD obj_col steps {int(vad.step('obj_col')[whole].sum())}, "
                f"of them with a contact {int((vad.step('obj_col') & vad.step('before_mask'))[whole].sum())} | "
                f"exact any {100 * exact.collision[whole].any(axis=1).mean():.2f}"
            )


def with_few_colours(picture: bytes) -> bytes:
    """The same picture in a palette, a third of the size."""
    image = Image.open(io.BytesIO(picture)).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    return buffer.getvalue()


if __name__ == "__main__":
    main()
