"""Table 3 of the paper: subject consistency and imaging quality by split, ours and the published ones."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

from benchmark.quality.records import QualityRecord
from benchmark.storage import content_key
from leaderboard.collision import FEW_NOTE, FEW_SCENES, SPLIT_ORDER
from leaderboard.tables import UNDEFINED, Table, interval, number

SOURCE: Final = "Challenger: Affordable Adversarial Driving Video Generation, Table 3"
TABLE_3: Final = {
    "val": ("nuScenes-val", "0.8349", "0.3801"),
    "val-r": ("nuScenes-val-R", "0.8173", "0.3471"),
    "adv": ("Adv-nuSc", "0.8093", "0.3469"),
}
"""The paper's name, subject consistency and imaging quality of each split, as printed."""
_COLUMNS: Final = (
    "split",
    "subjects",
    "SC",
    "95 %",
    "IQ",
    "95 %",
    "IQ of frames",
    "95 %",
    "vehicles",
    "appearances",
    "scenes",
    "SC (paper)",
    "IQ (paper)",
)
_GROUPS: Final = ("all", "adversary", "others")


def quality_tables(records: Sequence[QualityRecord]) -> list[Table]:
    """One table for each source of masks, definition, set of weights and kind of device: nothing else compares.

    Args:
        records: Quality records of one data set.

    Returns:
        The tables, the paper's source of masks first.
    """
    kinds: dict[str, list[QualityRecord]] = {}
    for record in records:
        kinds.setdefault(_kind(record), []).append(record)
    ordered = sorted(
        kinds.values(), key=lambda found: (found[0].masks != "grounded-sam2", found[0].masks, _kind(found[0]))
    )
    of_source = Counter(found[0].masks for found in ordered)
    return [_table(found, several=of_source[found[0].masks] > 1) for found in ordered]


def published_quality_table() -> Table:
    """The paper's Table 3 as printed."""
    return Table(
        name="quality-published",
        title="Video quality as published",
        columns=("data set", "SC", "IQ"),
        rows=tuple(TABLE_3.values()),
        notes=(f"Source: {SOURCE}.",),
    )


def _table(records: Sequence[QualityRecord], *, several: bool) -> Table:
    kind = _kind(records[0])
    name = f"quality-{records[0].masks}" + (f"-{kind[:8]}" if several else "")
    chosen = _one_each(records)
    rows = [row for record in chosen for row in _rows(record)]
    data_name, definition = chosen[0].facts.data.name, chosen[0].facts.definition
    return Table(
        name=name,
        title=f"{data_name}: video quality, masks from {chosen[0].masks}, {_frame_rate(definition)}",
        columns=_COLUMNS,
        rows=tuple(rows),
        notes=(
            "SC: subject consistency (VBench, DINO ViT-B/16), mean over the appearances of each vehicle after its "
            "first; IQ: imaging quality (VBench, MUSIQ trained on SPAQ) of vehicles' regions, and of whole frames. "
            "Brackets: 95 % bootstrap interval over recorded scenes. What is measured in detail: docs/quality.md.",
            *_what_was_seen(chosen),
            f"Paper: {SOURCE}; its frame rate, resolution and regions are not published, so that its values are a "
            "reference and no target.",
        ),
        text_columns=2,
    )


def _rows(record: QualityRecord) -> list[tuple[str, ...]]:
    summary, split = record.facts.summary, record.facts.split
    paper = TABLE_3.get(split, ("", UNDEFINED, UNDEFINED))
    rows: list[tuple[str, ...]] = []
    for group in _GROUPS:
        if group not in summary.groups:
            continue
        found = summary.groups[group]
        whole = summary.frames_imaging if group == "all" else None
        rows.append(
            (
                split,
                group,
                number(found.consistency.value, 4),
                interval(found.consistency.low, found.consistency.high, digits=3),
                number(found.imaging.value, 4),
                interval(found.imaging.low, found.imaging.high, digits=3),
                number(whole.value, 4) if whole else UNDEFINED,
                interval(whole.low, whole.high, digits=3) if whole else UNDEFINED,
                str(found.subjects),
                str(found.appearances),
                str(len(record.facts.scenes)),
                *(paper[1:] if group == "all" else (UNDEFINED, UNDEFINED)),
            )
        )
    return rows


def _what_was_seen(records: Sequence[QualityRecord]) -> list[str]:
    """What makes rows differ beside the split: size and format of frames, parts of splits, few scenes."""
    notes = []
    seen = {record.facts.split: _frames(record) for record in records}
    if len(set(seen.values())) > 1:
        said = "; ".join(f"{split}: {frames}" for split, frames in seen.items())
        notes.append(f"Frames differ between splits, and with them the numbers: {said}.")
    else:
        notes.append(f"Frames: {next(iter(seen.values()))}.")
    for record in records:
        if not record.covers_split:
            of = f"{len(record.facts.scenes)} of {record.facts.scenes_in_split} scenes"
            notes.append(f"{record.facts.split}: {of} of the split only.")
    if any(len({facts.source for facts in record.facts.scene_facts.values()}) < FEW_SCENES for record in records):
        notes.append(FEW_NOTE)
    return notes


def _frames(record: QualityRecord) -> str:
    sizes = sorted({(video.width, video.height) for video in record.videos})
    formats = sorted({name for video in record.videos for name in video.formats})
    return f"{', '.join(f'{width} x {height}' for width, height in sizes)} pixels, {', '.join(formats)}"


def _frame_rate(definition: dict[str, object]) -> str:
    return "2 Hz keyframes" if definition["frames"] == "keyframes" else "12 Hz frames"


def _one_each(records: Sequence[QualityRecord]) -> list[QualityRecord]:
    """For each split the record with most scenes, in the order of the paper."""
    best: dict[str, QualityRecord] = {}
    for record in sorted(records, key=lambda record: (-len(record.facts.scenes), record.directory.as_posix())):
        best.setdefault(record.facts.split, record)
    rank = {split: index for index, split in enumerate(SPLIT_ORDER)}
    return [best[split] for split in sorted(best, key=lambda split: (rank.get(split, len(rank)), split))]


def _kind(record: QualityRecord) -> str:
    facts = record.facts
    weights = {name: used.content for name, used in facts.weights.items()}
    return content_key(facts.definition, weights, facts.device)
