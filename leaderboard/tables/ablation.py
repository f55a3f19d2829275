"""The paper's ablation study, ours beside the published one: from ablation records."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

from benchmark.metrics.rates import PairedDifference
from benchmark.published import ABLATION_SOURCE
from benchmark.records.ablation import VARIANTS, AblationReport, AblationRow
from benchmark.report.cells import PERCENT, RANKS_NOTHING, CellSource, TableCell, ValueSource, format_record_name
from benchmark.report.table import Table
from benchmark.report.words import pluralise
from leaderboard.frame.specification import (
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.tables.published import quote_number

_BY_NAME: Final = {variant.name: variant for variant in VARIANTS}


def ablation_tables(ablations: Sequence[AblationReport]) -> dict[str, tuple[Table, ...]]:
    """A table for each study, by name of the data set; a study that is there twice counts once."""
    by_id = {study.content_id: study for study in ablations}
    ordered = sorted(by_id.values(), key=lambda study: (study.data.name, study.planner.name, study.content_id))
    same = Counter((study.data.name, study.planner.name) for study in ordered)
    tables_by_name: dict[str, tuple[Table, ...]] = {}
    for study in ordered:
        several = same[study.data.name, study.planner.name] > 1
        table = _table(study, f"-{study.content_id[:8]}" if several else "")
        tables_by_name[study.data.name] = (*tables_by_name.get(study.data.name, ()), table)
    return tables_by_name


def _table(study: AblationReport, suffix: str) -> Table:
    judge, version = study.protocol
    return tabulate(
        f"ablation-{study.planner.name}{suffix}",
        f"{study.data.name}: ablation of the search with {study.planner.name} (collision rate in %), protocol {judge} "
        f"(version {version})",
        [
            *text_columns("search"),
            *group_columns("vehicles", number_columns("tried", "kept", "discarded")),
            *group_columns(
                f"collision rate in %, {judge}",
                number_columns("collisions"),
                estimate_columns("of tried", "of kept", digits=2, ends=2, beside="95 % {}"),
            ),
            *group_columns(
                "difference of tried in points",
                estimate_columns("full minus", digits=2, ends=2, beside="95 % {}", signed=True),
            ),
            *group_columns("smallest gap in m", number_columns("mean gap, m", digits=2)),
            *group_columns("paper, collision rate in %, uniad", number_columns("paper")),
        ],
        [_row(study, row) for row in study.rows],
        (
            f"{pluralise(len(study.scenes), 'recorded scene')}; every row tries the same vehicles. MTR: multi-round "
            f"refinement, TS: scoring. Collisions: samples whose plan touches {study.whom} within 3 s / samples of "
            "kept attempts; of tried: the same over the samples of all tried vehicles, the paper's reading; full "
            "minus: the first row's of tried minus this one's. Brackets: 95 % bootstrap interval over recorded scenes, "
            "of differences Student's.",
            "Paper: UniAD on 20 nuScenes scenes rendered by MagicDriveDiT; another planner, other scenes and another "
            "renderer, so only the direction of the differences is comparable.",
            *(
                [f"{study.planner.name} is a miniature: it {RANKS_NOTHING} (docs/miniatures.md)."]
                if study.planner.miniature
                else []
            ),
        ),
        sources=(ABLATION_SOURCE,),
    )


def _difference(judged: ValueSource, of: PairedDifference) -> CellSource:
    return judged.cell(of.value, "points", of.recordings, "recordings", low=of.low, high=of.high, scale=100.0)


def _row(study: AblationReport, row: AblationRow) -> Values:
    record = format_record_name(study.content_id, study.planner.name, f"ablation {row.name}")
    judged, plain = ValueSource(study.protocol[0], record), ValueSource(record=record)
    variant = _BY_NAME.get(row.name)
    colliding = judged.count(row.colliding_samples, "samples", row.samples_kept)
    paper = ValueSource("uniad", source=ABLATION_SOURCE)
    return {
        "search": TableCell(row.name if variant is None else variant.label, miniature=study.planner.miniature),
        "tried": plain.count(row.attempted, "vehicles"),
        "kept": plain.count(row.kept, "vehicles", row.attempted),
        "discarded": plain.count(sum(row.discarded.values()), "vehicles", row.attempted),
        "collisions": colliding.shown(after=f"/{row.samples_kept}"),
        "of tried": judged.percent(row.rate_attempted),
        "of kept": judged.percent(row.rate_kept),
        "full minus": None if row.full_minus is None else _difference(judged, row.full_minus),
        "mean gap, m": plain.cell(row.mean_gap_m, "m", row.kept, "vehicles"),
        "paper": None if variant is None else quote_number(variant.published, PERCENT, paper),
    }
