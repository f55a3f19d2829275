"""The paper's ablation study, ours beside the published one: from ablation records."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

from benchmark.published import ABLATION_SOURCE
from benchmark.records.ablation import VARIANTS, AblationReport, AblationRow
from benchmark.report.cells import PERCENT, RANKS_NOTHING, UNDEFINED, Origin, Shown, named_record
from benchmark.report.table import Table, table_of
from benchmark.report.words import counted
from leaderboard.tables.published import quoted

_BY_NAME: Final = {variant.name: variant for variant in VARIANTS}


def ablation_tables(ablations: Sequence[AblationReport]) -> dict[str, tuple[Table, ...]]:
    """One table for each study.

    Args:
        ablations: Studies, in any order; a study that is there twice counts once.

    Returns:
        Tables by name of the data set.
    """
    by_id = {study.content_id: study for study in ablations}
    ordered = sorted(by_id.values(), key=lambda study: (study.data.name, study.planner.name, study.content_id))
    same = Counter((study.data.name, study.planner.name) for study in ordered)
    found: dict[str, tuple[Table, ...]] = {}
    for study in ordered:
        several = same[study.data.name, study.planner.name] > 1
        table = _table(study, f"-{study.content_id[:8]}" if several else "")
        found[study.data.name] = (*found.get(study.data.name, ()), table)
    return found


def _table(study: AblationReport, suffix: str) -> Table:
    judge, version = study.protocol
    return table_of(
        f"ablation-{study.planner.name}{suffix}",
        f"{study.data.name}: ablation of the search with {study.planner.name} (collision rate in %), protocol {judge} "
        f"(version {version})",
        (
            *("search", "tried", "kept", "discarded", "collisions"),
            *("of tried", "95 % of tried", "of kept", "95 % of kept", "mean gap, m", "paper"),
        ),
        [_row(study, row) for row in study.rows],
        notes=(
            f"{counted(len(study.scenes), 'recorded scene')}; every row tries the same vehicles. MTR: multi-round "
            "refinement, TS: scoring. Collisions: colliding samples / samples of kept attempts; of tried: the same "
            "over the samples of all tried vehicles, the paper's reading. Brackets: 95 % bootstrap interval over "
            "recorded scenes.",
            "Paper: UniAD on 20 nuScenes scenes rendered by MagicDriveDiT; another planner, other scenes and another "
            "renderer, so that only the direction of the differences compares.",
            *(
                [f"{study.planner.name} is a miniature: it {RANKS_NOTHING} (docs/miniatures.md)."]
                if study.planner.miniature
                else []
            ),
        ),
        groups=(
            ("", 1),
            ("vehicles", 3),
            (f"collision rate in %, {judge}", 5),
            ("smallest gap in m", 1),
            ("paper, collision rate in %, uniad", 1),
        ),
        sources=(ABLATION_SOURCE,),
    )


def _row(study: AblationReport, row: AblationRow) -> tuple[str | Shown, ...]:
    record = named_record(study.content_id, study.planner.name, f"ablation {row.name}")
    judged, plain = Origin(study.protocol[0], record), Origin(record=record)
    variant = _BY_NAME.get(row.name)
    rates = [judged.percent(rate) for rate in (row.rate_attempted, row.rate_kept)]
    colliding = judged.count(row.colliding_samples, "samples", row.samples_kept)
    published: Shown | str = UNDEFINED
    if variant is not None:
        published = quoted(variant.published, PERCENT, Origin("uniad", source=ABLATION_SOURCE))
    return (
        Shown(row.name if variant is None else variant.label, miniature=study.planner.miniature),
        plain.count(row.attempted, "vehicles").shown(),
        plain.count(row.kept, "vehicles", row.attempted).shown(),
        plain.count(sum(row.discarded.values()), "vehicles", row.attempted).shown(),
        colliding.shown(after=f"/{row.samples_kept}"),
        *(shown for cell in rates for shown in (cell.shown(2), cell.interval(2))),
        plain.cell(row.mean_gap_m, "m", row.kept, "vehicles").shown(2),
        published,
    )
