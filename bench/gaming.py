"""The table "what each score can be gamed by" of docs/metrics.md: six baselines that look at little under every score.

Run as ``python bench/gaming.py --out OUT``. The embedded data set and the newest frozen split of it are built where
they are missing; plans that are kept below OUT are judged again. Cells are ``val / adv``.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

from adapters.registry import planner_factory
from benchmark.api import frozen_root
from benchmark.datasets.roots import open_data
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.workspace import EMBEDDED, cache_root
from benchmark.metrics.consistency import MEAN, consistency
from benchmark.protocols import PROTOCOLS
from benchmark.records.driving import SUB_SCORES, TOTALS
from benchmark.records.run import RunRecord
from benchmark.report.cells import number
from benchmark.report.table import Table
from generation.sources.mini import TownSettings, build_town

PLANNERS = ("stop", "constant-velocity", "ego-status", "constant-velocity-on-path", "idm", "log-replay")
BLIND = PLANNERS[:3]
"""Those that see nothing but the car's own motion and command."""
SPLITS = ("val", "adv")


@dataclass(frozen=True)
class Score:
    """A score by name and how to read it from a record; of some more is better."""

    name: str
    protocol: str = ""
    column: str = ""
    digits: int = 1
    more_is_better: bool = False

    def of(self, record: RunRecord) -> float | None:
        """Its value in a record, in the unit of its name."""
        if self.protocol:
            found = record.summary.protocols[self.protocol].columns[self.column]["avg"].value
            scale = 1.0 if self.column == "l2" else 100.0
        elif self.column == MEAN:
            found, scale = consistency(record).distances[MEAN].value, 1.0
        else:
            assert record.summary.driving is not None
            found, scale = record.summary.driving.columns[self.column]["mean"].value, 100.0
        return None if found is None else scale * found


SCORES = (
    *(Score(f"collision avg, {name}, %", name, "collision") for name in ("exact", "uniad", "vad", "sparsedrive")),
    Score("any contact up to 3 s, bev-planner, avg, %", "bev-planner", "collision"),
    Score("at the kerb, bev-planner, avg, %", "bev-planner", "kerb"),
    Score("off road, omnidrive, avg, %", "omnidrive", "off_road"),
    *(Score(f"L2 avg, {name}, m", name, "l2", 2) for name in ("exact", "uniad", "vad")),
    *(
        Score(f"pdm {name.replace('_', ' ').replace('ec', 'EC')}, %", "", name, 1, more_is_better=True)
        for name in TOTALS
    ),
    *(Score(f"{name.upper()}, %", "", name, 1, more_is_better=True) for name in SUB_SCORES),
    Score("plan consistency, m", "", MEAN, 2),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args()
    settings = TownSettings()
    source = open_data(build_town(cache_root() / settings.folder_name(EMBEDDED), settings, workers=2), name=EMBEDDED)
    splits = {"val": source, "adv": open_data(frozen_root(source), name=EMBEDDED)}
    judges = EvalSettings(protocols=tuple(PROTOCOLS))
    records = {
        (name, split): evaluate(data, split, planner_factory(name), options.out / "runs", judges)
        for split, data in splits.items()
        for name in PLANNERS
    }
    print(table(records).markdown())


def table(records: dict[tuple[str, str], RunRecord]) -> Table:
    """Scores in rows, baselines in columns.

    Args:
        records: By planner and split.

    Returns:
        The table; its last column is who of those that see nothing has the best value on adversarial scenes.
    """
    rows = []
    for score in SCORES:
        values = {key: score.of(record) for key, record in records.items()}
        cells = [" / ".join(number(values[name, split], score.digits) for split in SPLITS) for name in PLANNERS]
        rows.append((score.name, *cells, best(score, {name: values[name, "adv"] for name in BLIND})))
    heads = [f"{name} †" if records[name, "val"].run.planner.privileged else name for name in PLANNERS]
    return Table(
        "gaming",
        "What each score can be gamed by (val / adv)",
        ("score", *heads, "best without looking"),
        tuple(rows),
    )


def best(score: Score, values: dict[str, float | None]) -> str:
    """Who has the best value; several if they share it."""
    known = {name: value for name, value in values.items() if value is not None}
    first = (max if score.more_is_better else min)(known.values())
    return ", ".join(name for name, value in known.items() if value == first)


if __name__ == "__main__":
    main()
