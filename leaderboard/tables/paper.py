"""The paper's tables as printed, apart from ours."""

from typing import Final

from benchmark.published import ADV_NUSC, DATA_SET_SOURCE, RUNTIME_MACHINE, RUNTIME_S, RUNTIME_SOURCE
from benchmark.records.ablation import SOURCE as ABLATION_SOURCE
from benchmark.records.ablation import VARIANTS
from benchmark.report.cells import PERCENT, Origin, Shown
from benchmark.report.table import Table, table_of
from leaderboard.tables.published import QUALITY_SOURCE, SOURCE, TABLE_1, TABLE_3, published_cells, quoted

_RATES: Final = "collision rate in %, the protocol of the row"


def published_tables() -> tuple[Table, ...]:
    """Every table of the paper that has a counterpart among ours."""
    return (
        published_table(),
        published_ablation_table(),
        published_quality_table(),
        published_data_set_table(),
        published_runtime_table(),
    )


def published_table() -> Table:
    """The paper's Table 1, with the protocol behind each row."""
    return table_of(
        "published",
        "Published numbers, not ours: collision rate (%)",
        ("planner", "data set", "protocol", "col. 1s", "col. 2s", "col. 3s", "col. avg", "increase"),
        [(rate.model, rate.data_set, rate.protocol, *published_cells(rate)) for rate in TABLE_1],
        notes=(
            "Each row quotes the protocol of the model's own repository; rows of different protocols are not "
            "comparable with each other, nor with our tables unless the protocol is the same.",
        ),
        text_columns=3,
        groups=(("", 3), (_RATES, 5)),
        sources=(SOURCE,),
    )


def published_ablation_table() -> Table:
    """The paper's ablation study."""
    origin = Origin(protocol="uniad", source=ABLATION_SOURCE)
    return table_of(
        "ablation-published",
        "Published numbers, not ours: ablation, collision rate (%)",
        ("search", "collision rate"),
        [(variant.label, quoted(f"{100 * variant.paper_rate:.2f}", PERCENT, origin)) for variant in VARIANTS],
        notes=("UniAD on 20 scenes of the nuScenes validation set; MTR: multi-round refinement, TS: scoring.",),
        groups=(("", 1), ("samples on which UniAD fails in %, uniad", 1)),
        sources=(ABLATION_SOURCE,),
    )


def published_quality_table() -> Table:
    """The paper's Table 3."""
    origin = Origin(source=QUALITY_SOURCE)
    return table_of(
        "quality-published",
        "Published numbers, not ours: video quality",
        ("data set", "SC", "IQ"),
        [
            (name, quoted(consistency, "SC", origin), quoted(imaging, "IQ", origin))
            for name, (consistency, imaging) in TABLE_3.items()
        ],
        notes=("SC: subject consistency, IQ: imaging quality.",),
        sources=(QUALITY_SOURCE,),
    )


def published_data_set_table() -> Table:
    """The paper's overview of its data set."""
    return table_of(
        "data-set-published",
        "Published numbers, not ours: rows of Adv-nuSc",
        ("rows of", "Adv-nuSc"),
        [(name.replace("_", " "), published_rows(name)) for name in ADV_NUSC],
        sources=(DATA_SET_SOURCE,),
    )


def published_runtime_table() -> Table:
    """The paper's runtime of one scene."""
    total = sum(RUNTIME_S.values())
    seconds = {**RUNTIME_S, "all": total}
    origin = Origin(source=RUNTIME_SOURCE)
    return table_of(
        "runtime-published",
        "Published numbers, not ours: seconds for one scene",
        ("stage", "seconds", "%"),
        [
            (stage, published_seconds(stage), origin.cell(value / total, PERCENT, None, scale=100.0).shown(1))
            for stage, value in seconds.items()
        ],
        notes=(f"About 240 frames and six cameras on {RUNTIME_MACHINE}.",),
        sources=(RUNTIME_SOURCE,),
    )


def published_rows(name: str) -> Shown:
    """Rows of a table of Adv-nuSc, as printed."""
    return quoted(f"{ADV_NUSC[name]:,}", "rows", Origin(source=DATA_SET_SOURCE))


def published_seconds(stage: str) -> Shown | str:
    """Seconds of a stage of one scene as printed, of ``all`` stages together, or a dash where none are printed."""
    seconds = sum(RUNTIME_S.values()) if stage == "all" else RUNTIME_S.get(stage)
    return Origin(source=RUNTIME_SOURCE).cell(seconds, "s", None).shown(2)
