"""How often the test for leaked futures suspects honest planners, and which leaks it finds.

Run as ``python bench/leaks.py --data mini RECORDS...`` with folders of records of runs and of drives. Each record gives
a row of its figures; then plans of each run that is not privileged are replaced by the recorded future with noise: on
all samples, on those where who keeps speed and direction touches somebody, and on those where its own plan collides.
``docs/submitting.md`` shows the tables.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark import api
from benchmark.constants import PLAN_STEPS
from benchmark.datasets.roots import DataSet
from benchmark.extensions.submissions.checking import Record, facts_of_record
from benchmark.extensions.submissions.leaked_futures import figures_of, moments_of_run
from benchmark.geometry import Floats
from benchmark.metrics.leaks import LeakFigures, Moment, leak_figures
from benchmark.records.drives import find_drives
from benchmark.records.run import RunRecord, find_records

Noise = Callable[[np.random.Generator], Floats]
LEAKS_ON: Final = ("all", "dangerous", "own contacts")


def each_step(metres: float) -> Noise:
    """Noise that is drawn anew at each step."""
    return lambda rng: rng.normal(0.0, metres, (PLAN_STEPS, 2))


def growing(metres: float) -> Noise:
    """One offset that grows with time as errors of planners do, and is so large after 3 s."""
    grows = np.linspace(1 / PLAN_STEPS, 1.0, PLAN_STEPS)[:, None] ** 1.5
    return lambda rng: rng.normal(0.0, metres, 2) * grows


NOISES: Final[dict[str, Noise]] = {
    "0.06 m": each_step(0.06),
    "0.12 m": each_step(0.12),
    "0.25 m": each_step(0.25),
    "0.3 m growing": growing(0.3),
    "0.6 m growing": growing(0.6),
}


def scenes_of(record: RunRecord, data: DataSet) -> list[tuple[Moment, bool]]:
    """Moments of all scenes, and whether the plan of each touches somebody."""
    found: list[tuple[Moment, bool]] = []
    for name, rows in groupby(record.rows, key=lambda row: row.scene):
        listed = list(rows)
        moments = moments_of_run(listed, data.truth(name))
        found += [(moment, any(listed[index].outcomes["exact"].collision)) for index, moment in moments.items()]
    return found


def leaked(moments: list[tuple[Moment, bool]], on: str, noise: Noise) -> LeakFigures:
    """The figures of a run some of whose plans are replaced by the recorded future with noise."""
    return leak_figures(list(_replaced(moments, on, noise, np.random.default_rng(0))))


def _replaced(moments: list[tuple[Moment, bool]], on: str, noise: Noise, rng: np.random.Generator) -> Iterator[Moment]:
    for moment, touches in moments:
        chosen = {"all": True, "dangerous": moment.dangerous, "own contacts": touches}[on]
        yield replace(moment, planned=moment.recorded + noise(rng)) if chosen else moment


def row_of(record: Record, found: LeakFigures) -> str:
    """One line of figures."""
    facts = facts_of_record(record)
    kind = "run" if isinstance(record, RunRecord) else "drives"
    values = (
        *(found.error_m, found.growth, found.growth_in_danger),
        *(found.hits / found.surprises if found.surprises else None, found.ratio, found.ratio_in_danger),
        found.ratio_braking,
    )
    shown = " ".join("     –" if value is None else f"{value:6.2f}" for value in values)
    name = f"{record.planner}{' †' if facts.planner.privileged else ''}"
    return f"{kind:6} {facts.split:6} {name:28} {found.moving:5} {found.surprises:5} {shown} {len(found.suspicions):3}"


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", default="mini")
    parser.add_argument("--out", type=Path, default=api.OUT)
    parser.add_argument("records", nargs="+", type=Path)
    asked = parser.parse_args()
    source = api.open_data(asked.data, out=asked.out)
    opened: dict[str, DataSet] = {}
    runs = find_records(*asked.records)
    records: list[Record] = [*runs, *find_drives(*asked.records)]
    print("kind   split  planner                      moves surpr  error growth danger   hits  ratio danger brakes sus")
    for record in records:
        split = facts_of_record(record).split
        if split not in opened:
            opened[split] = api.open_split(source, split, out=asked.out)
        print(row_of(record, figures_of(record, opened[split])), flush=True)
    honest = [scenes_of(run, opened[run.run.split]) for run in runs if not run.run.planner.privileged]
    print(f"\nleaks found of {len(honest)} runs   " + "".join(f"{name:>16}" for name in NOISES))
    for on in LEAKS_ON:
        found = [sum(bool(leaked(each, on, noise).suspicions) for each in honest) for noise in NOISES.values()]
        print(f"{on:24}" + "".join(f"{count:16}" for count in found), flush=True)


if __name__ == "__main__":
    main()
