"""The presets beside each other: what each tries and keeps, how close it comes, what it does, and who then collides.

Run as ``python bench/presets.py --data mini --data ROOT --seed 0 --seed 1``. Each (data set, preset, seed) is a build
of its own below ``--folder``; what is finished there is only read, so the same command goes on where it was broken off.
Planners judge the most challenging scene of each recording. ``docs/generation.md`` shows the table.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark import api
from benchmark.datasets.roots import DataSet, open_data
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.storage import read_kept_json, write_json
from benchmark.machine.workers import LocalProcesses, single_threaded
from benchmark.published import ADV_NUSC, TABLE_1
from benchmark.records.attempts import ATTEMPTS_FILE, Attempt, read_attempts
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.search.presets import PRESETS, Preset, hyper_parameters, trajectory_model

BLIND: Final = ("constant-velocity",)
"""Planners that look at no images and mean something on any data."""
CLOSE_M: Final = 1.0


@dataclass(frozen=True)
class Case:
    """One build."""

    data: str
    preset: str
    seed: int

    def name(self, label: str) -> str:
        """Of its files."""
        return f"{label}{Path(self.data).name}-{self.preset}-{self.seed}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", action="append", help="mini or the root of a data set with a map; may be repeated")
    parser.add_argument("--seed", action="append", type=int)
    parser.add_argument("--preset", action="append", choices=PRESETS)
    parser.add_argument("--miniature", action="append", default=[], help="also judge with this network, on mini alone")
    parser.add_argument("--limit", type=int, help="only the first so many scenes")
    parser.add_argument("--set", action="append", default=[], help="NAME=VALUE, as of generate")
    parser.add_argument("--label", default="", help="before the names of results, to tell settings apart")
    parser.add_argument("--folder", type=Path, default=Path("challenger-out") / "presets")
    options = parser.parse_args()
    single_threaded()
    found: list[dict[str, Any]] = []
    for data in options.data or ["mini"]:
        for preset in options.preset or PRESETS:
            for seed in options.seed or [0]:
                case = Case(data, preset, seed)
                path = options.folder / f"{case.name(options.label)}.json"
                row = read_kept_json(path)
                if not isinstance(row, dict):
                    row = measured(case, options)
                    write_json(path, row)
                found.append(row)
                print(f"{path.stem}: {row['kept']} of {row['tried']} kept", file=sys.stderr, flush=True)
    print(table(found))


def measured(case: Case, options: argparse.Namespace) -> dict[str, Any]:
    """Build and judge one case."""
    root = options.folder / case.name(options.label)
    source = open_data(Path(case.data)) if Path(case.data).is_dir() else api.open_data(case.data, workers=1)
    sighted = options.miniature if case.data == "mini" else []
    preset = cast(Preset, case.preset)
    settings = BuildSettings(
        out=root / "data",
        hyper=hyper_parameters(preset, None, options.set),
        prior=trajectory_model(preset),
        limit=options.limit,
        seed=case.seed,
        per_scene=1,
        renderer=api.schematic_renderer() if sighted else None,
        frames="keyframes",
        executor=LocalProcesses(1),
    )
    written: DataSet | None = None
    try:
        build_split(source, "adv", settings)
        written = open_data(settings.out, version=settings.version, name=source.name)
    except NothingSurvivedError as nothing:
        print(nothing, file=sys.stderr)
    attempts = read_attempts(settings.out / ATTEMPTS_FILE)
    rates = {
        planner: (
            rate(source, "val", planner, case, options),
            None if written is None else rate(written, "adv", planner, case, options),
        )
        for planner in (*BLIND, *sighted)
    }
    return {"data": Path(case.data).name, "preset": case.preset, "seed": case.seed, **counts(attempts), "rates": rates}


def counts(attempts: Sequence[Attempt]) -> dict[str, Any]:
    """What came of the attempts."""
    kept = [each for each in attempts if each.kept]
    gaps = [each.closest_approach.gap_m for each in kept if each.closest_approach is not None]
    return {
        "tried": len(attempts),
        "kept": len(kept),
        "scenes": len({each.scene for each in kept}),
        "why_not": dict(Counter(each.discard for each in attempts if each.discard is not None).most_common()),
        "gaps": gaps,
        "manoeuvres": dict(Counter(each.labels.manoeuvre for each in kept if each.labels is not None).most_common()),
    }


def rate(data: DataSet, split: str, planner: str, case: Case, options: argparse.Namespace) -> tuple[int, int]:
    """Colliding samples and samples, by exact geometry."""
    place = "recordings" if split == "val" else case.name(options.label)
    limit = options.limit if split == "val" else None
    settings = EvalSettings(protocols=("exact",), limit=limit)
    runs = options.folder / "runs" / f"{place}-{Path(case.data).name}"
    record = evaluate(data, split, api.load_planner(planner, data=case.data), runs, settings)
    outcomes = [row.outcomes["exact"] for row in record.rows if row.outcomes]
    counted = [outcome for outcome in outcomes if outcome.counted]
    return sum(any(outcome.collision or ()) for outcome in counted), len(counted)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown, a row for each data set and preset, seeds together."""
    planners = list(dict.fromkeys(name for row in rows for name in row["rates"]))
    head = [
        "data",
        "preset",
        "seeds",
        "tried",
        "kept",
        "recordings",
        "why not",
        "gap, m",
        "touch",
        "manoeuvres",
        *planners,
    ]
    lines = [f"| {' | '.join(head)} |", "|---|---|--:|--:|--:|--:|---|--:|--:|---|" + "--:|" * len(planners)]
    for data, preset in dict.fromkeys((row["data"], row["preset"]) for row in rows):
        mine = [row for row in rows if (row["data"], row["preset"]) == (data, preset)]
        gaps = [gap for row in mine for gap in row["gaps"]]
        tried, kept = (sum(row[name] for row in mine) for name in ("tried", "kept"))
        cells = [
            data,
            preset,
            str(len(mine)),
            str(tried),
            f"{kept} ({100 * kept / max(tried, 1):.0f} %)",
            str(sum(row["scenes"] for row in mine)),
            together(mine, "why_not"),
            f"{np.median(gaps):.2f}" if gaps else "-",
            str(sum(gap == 0.0 for gap in gaps)),
            together(mine, "manoeuvres") or "-",
            *(risen(mine, planner) for planner in planners),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", papers()])


def together(rows: Sequence[dict[str, Any]], name: str) -> str:
    """Counts of several seeds, most frequent first."""
    total: Counter[str] = Counter()
    for row in rows:
        total.update(row[name])
    return ", ".join(f"{count} {what}" for what, count in total.most_common())


def risen(rows: Sequence[dict[str, Any]], planner: str) -> str:
    """Rate on the recordings and on what was made of them, per cent of the samples."""
    shown = []
    for place in (0, 1):
        judged = [row["rates"][planner][place] for row in rows if planner in row["rates"]]
        hits, samples = (sum(each[index] for each in judged if each) for index in (0, 1))
        shown.append(f"{100 * hits / samples:.1f}" if samples else "-")
    return " -> ".join(shown)


def papers() -> str:
    """What the paper says of its data set."""
    mean = {row.model: row.percent[3] for row in TABLE_1 if row.data_set == "Adv-nuSc"}
    before = {row.model: row.percent[3] for row in TABLE_1 if row.data_set == "nuScenes-val"}
    rates = ", ".join(f"{model} {before[model]} -> {percent}" for model, percent in mean.items())
    return (
        f"The paper: {ADV_NUSC['scenes']} scenes of 150 recordings with up to 10 vehicles each, "
        f"{ADV_NUSC['samples']:,} samples, {ADV_NUSC['annotations']:,} annotations of {ADV_NUSC['instances']:,} "
        "instances; it says neither how many were tried nor how close they come. "
        f"Collision rates, val -> Adv-nuSc, %: {rates}."
    )


if __name__ == "__main__":
    main()
