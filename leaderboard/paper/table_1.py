"""The paper's Table 1 in its two-column form: two planners beside each other, a line for each data set."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from benchmark.metrics.rates import HORIZONS
from benchmark.metrics.scores import takes_maxima
from benchmark.published import DATA_SET_OF_SPLIT, TABLE_1_SOURCE
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, UNDEFINED, Origin, Shown, origin_of, record_name
from benchmark.report.table import LatexForm, Table, table_of
from leaderboard.frame.rows import SPLIT_ORDER, in_table_order, name_cell, run_notes, stale_notes, with_caveat_mark
from leaderboard.tables.published import published_increase, published_rate, quoted

_ORDER: Final = ("uniad", "vad", "sparsedrive", "diffusiondrive")
"""Of the paper, by the planners' own protocols: the first half stands on the left."""
_HERE, _PAPER = "here, own protocol", "paper, own protocol"
_DIGITS: Final = {"sparsedrive": 3, "diffusiondrive": 3}
"""As the paper prints them; all others have two."""
_HEADS: Final = ("AD model", *HORIZONS, "×", "avg", "×")


@dataclass(frozen=True, slots=True)
class _Block:
    """One planner: its runs by split."""

    planner: str
    runs: dict[str, RunRecord]

    @property
    def first(self) -> RunRecord:
        return next(iter(self.runs.values()))


def paper_table_1(data_name: str, records: Sequence[RunRecord]) -> Table | None:
    """Table 1 as the paper lays it out, each planner under the protocol of its own repository.

    Args:
        data_name: Name of the data set, for the title.
        records: Runs on this data set; those on the paper's three splits count.

    Returns:
        Two planners a block, those of the paper first and in its order; published averages and increases have columns
        of their own. ``None`` without runs.
    """
    blocks = _blocks(records)
    if not blocks:
        return None
    splits = [split for split in SPLIT_ORDER if any(split in block.runs for block in blocks)]
    rows: list[tuple[str | Shown, ...]] = []
    for left, right in _pairs(blocks):
        for split in splits:
            rows.append((split, *_half(left, split), *_half(right, split)))
    shown = [run for block in blocks for run in block.runs.values()]
    said = ", ".join(f"{split} is {DATA_SET_OF_SPLIT[split]}" for split in splits)
    return table_of(
        "paper-table-1",
        f"{data_name}: performance of end-to-end driving systems across data sets, collision rate over 3 seconds (%)",
        ("data set", *_HEADS, *_HEADS),
        rows,
        notes=(
            "As in the paper each planner is judged by the protocol of its own repository (exact where it has none): "
            f"planners do not compare with each other. ×: (adv − val) / val of the averages. In the paper {said}.",
            *run_notes(shown, [note for run in shown for note in stale_notes(run, (run.native_protocol,))]),
        ),
        text_columns=2,
        groups=(("", 2), (_HERE, 5), (_PAPER, 2), ("", 1), (_HERE, 5), (_PAPER, 2)),
        sources=(TABLE_1_SOURCE,),
        latex_form=LatexForm(
            alignment=r"llrrrrrrr@{\hspace{1.5em}}lrrrrrrr",
            rules_after=tuple(range(len(splits), len(rows), len(splits))),
            # As in the paper the name stands once, in the middle of its lines.
            once=(1, 1 + len(_HEADS)),
            bold_rows=tuple(place for place in range(len(rows)) if rows[place][0] == "adv"),
            fit=True,
        ),
    )


def _blocks(records: Sequence[RunRecord]) -> list[_Block]:
    """Planners with their runs; the paper's first, then others with a protocol of their own, then the rest."""
    runs: dict[str, dict[str, RunRecord]] = {}
    for record in in_table_order(records):
        judged = record.native_protocol in record.summary.protocols and not takes_maxima(record.native_protocol)
        if record.run.split in SPLIT_ORDER and judged:
            runs.setdefault(record.planner, {})[record.run.split] = record
    blocks = [_Block(planner, of_planner) for planner, of_planner in runs.items()]
    return sorted(blocks, key=_place)


def _place(block: _Block) -> tuple[int, int, bool, str]:
    planner = block.first.run.planner
    own = planner.native_protocol
    place = _ORDER.index(own) if own in _ORDER else len(_ORDER)
    return int(own is None), place, planner.miniature, block.planner


def _pairs(blocks: Sequence[_Block]) -> list[tuple[_Block, _Block | None]]:
    """Which planners stand beside each other: of those with and of those without a protocol the halves."""
    pairs: list[tuple[_Block, _Block | None]] = []
    for without in (False, True):
        group = [block for block in blocks if (block.first.run.planner.native_protocol is None) == without]
        half = (len(group) + 1) // 2
        pairs += [(left, group[half + at] if half + at < len(group) else None) for at, left in enumerate(group[:half])]
    return pairs


def increase_over(baseline: float | None, rate: float | None) -> float | None:
    """The paper's "× increase": (rate - baseline) / baseline, ``None`` where the baseline is zero or unknown."""
    if baseline is None or rate is None or baseline == 0:
        return None
    return (rate - baseline) / baseline


def _half(block: _Block | None, split: str) -> tuple[str | Shown, ...]:
    """One planner's part of a line."""
    if block is None:
        return ("",) * len(_HEADS)
    name = name_cell(block.planner, block.first.run.planner)
    run = block.runs.get(split)
    if run is None:
        return (name, *(UNDEFINED,) * (len(_HEADS) - 1))
    name, judge = with_caveat_mark(name, run.run), run.native_protocol
    columns, origin = run.summary.protocols[judge].columns["collision"], origin_of(run, judge)
    rates = [origin.percent(columns[horizon]).shown(_DIGITS.get(judge, 2)) for horizon in HORIZONS]
    return (name, *rates, _increase(block, split), *_published(run))


def _increase(block: _Block, split: str) -> Shown:
    """From val to adv, where both are whole and judged alike."""
    run, baseline = block.runs[split], block.runs.get("val")
    judge = run.native_protocol
    if split != "adv" or baseline is None or not (run.covers_split and baseline.covers_split):
        return Shown("")
    summaries = [each.summary.protocols[judge] for each in (baseline, run)]
    same = summaries[0].version == summaries[1].version
    value = increase_over(*(summary.columns["collision"]["avg"].value for summary in summaries)) if same else None
    count = sum(summary.counted for summary in summaries)
    return Origin(judge, record_name(baseline, run)).cell(value, "×", count).shown(1, after="×")


def _published(run: RunRecord) -> tuple[Shown, Shown]:
    """The paper's average and increase, where they are of the same planner, protocol and split."""
    row = published_rate(run, run.native_protocol)
    if row is None:
        return Shown(""), Shown("")
    origin = Origin(protocol=row.protocol, source=TABLE_1_SOURCE)
    return quoted(row.percent[-1], PERCENT, origin), published_increase(row) or Shown("")
