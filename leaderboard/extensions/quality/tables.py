"""Table 3 of the paper: subject consistency and imaging quality by split, ours and the published ones."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.machine.storage import content_key
from benchmark.published import DATA_SET_OF_SPLIT, QUALITY_SOURCE
from benchmark.records.quality import QualityRecord
from benchmark.records.review import describe_review
from benchmark.report.cells import ValueSource, format_record_name
from benchmark.report.table import Table
from leaderboard.frame.rows import CAVEAT_MARK, FEW_NOTE, FEW_SCENES, describe_split_part, split_sort_key
from leaderboard.frame.specification import (
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.page.sections import Section
from leaderboard.tables.published import quote_quality

_MEASURES: Final = {
    "SC": "subject consistency",
    "IQ": "imaging quality of vehicles",
    "IQ of frames": "imaging quality of frames",
}
_COLUMNS: Final = [
    *text_columns("split", "subjects"),
    *(
        each
        for name, of in _MEASURES.items()
        for each in group_columns(of, estimate_columns(name, digits=4, ends=3, beside="95 %"))
    ),
    *group_columns("counted", number_columns("vehicles", "appearances", "scenes")),
    *group_columns("paper", number_columns("SC (paper)", "IQ (paper)")),
]
_BRIEF: Final = ("split", "subjects", "SC", "95 % of SC", "IQ", "95 % of IQ", "vehicles", "scenes")
"""Columns that a terminal shows."""
_MEASURES_NOTE: Final = (
    "SC: subject consistency (VBench, DINO ViT-B/16), mean over the appearances of each vehicle after its first; IQ: "
    "imaging quality (VBench, MUSIQ trained on SPAQ) of vehicles' regions, and of whole frames. Brackets: 95 % "
    "bootstrap interval over recorded scenes. Details: docs/extensions/quality.md."
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
        kinds.setdefault(_find_kind(record), []).append(record)
    ordered = sorted(
        kinds.values(), key=lambda found: (found[0].masks != "grounded-sam2", found[0].masks, _find_kind(found[0]))
    )
    of_source = Counter(kind_records[0].masks for kind_records in ordered)
    return [_table(kind_records, several=of_source[kind_records[0].masks] > 1) for kind_records in ordered]


def _table(records: Sequence[QualityRecord], *, several: bool) -> Table:
    kind = _find_kind(records[0])
    name = f"quality-{records[0].masks}" + (f"-{kind[:8]}" if several else "")
    chosen = _choose_records(records)
    rows = [row for record in chosen for row in _rows(record)]
    data_name, definition = chosen[0].facts.data.name, chosen[0].facts.definition
    title = f"{data_name}: video quality, masks from {chosen[0].masks}, {_frame_rate(definition)}"
    differences = _list_differences(chosen)
    paper = "Paper: frame rate, resolution and regions are not published: its values are a reference, not a target."
    return tabulate(
        name,
        title,
        _COLUMNS,
        rows,
        [_MEASURES_NOTE, *differences, paper],
        brief=_BRIEF,
        brief_notes=[_MEASURES_NOTE, *differences],
        sources=[QUALITY_SOURCE],
    )


def _rows(record: QualityRecord) -> Iterator[Values]:
    summary, split = record.facts.summary, record.facts.split
    origin = ValueSource(record=format_record_name(record.content_id, "video quality", split))
    frames = origin.amount(summary.frames_imaging, "IQ", "frames")
    paper = zip(("SC (paper)", "IQ (paper)"), quote_quality(DATA_SET_OF_SPLIT.get(split, "")))
    of_whole: Values = {"IQ of frames": frames, **dict(paper)}
    for group in _GROUPS:
        if group in summary.groups:
            group_summary = summary.groups[group]
            yield {
                "split": f"{split} {CAVEAT_MARK}" if record.caveats else split,
                "subjects": group,
                "SC": origin.amount(group_summary.consistency, "SC", "appearances"),
                "IQ": origin.amount(group_summary.imaging, "IQ", "appearances"),
                "vehicles": origin.count(group_summary.subjects, "vehicles"),
                "appearances": origin.count(group_summary.appearances, "appearances"),
                "scenes": origin.count(len(record.facts.scenes), "scenes", record.facts.scenes_in_split),
                **(of_whole if group == "all" else {}),
            }


def _list_differences(records: Sequence[QualityRecord]) -> list[str]:
    """Notes on differences of rows beside the split: size and format of frames, parts of splits, few scenes."""
    notes = []
    frames_by_split = {record.facts.split: _frames(record) for record in records}
    if len(set(frames_by_split.values())) > 1:
        frame_texts = "; ".join(f"{split}: {frames}" for split, frames in frames_by_split.items())
        notes.append(f"Frames, and so the numbers, differ between splits: {frame_texts}.")
    else:
        notes.append(f"Frames: {next(iter(frames_by_split.values()))}.")
    for record in records:
        notes += [f"{CAVEAT_MARK} {record.facts.split}: {caveat.sentence}." for caveat in record.caveats]
        if record.facts.review is not None:
            notes.append(f"{record.facts.split}: {describe_review(record.facts.review)}.")
        if not record.covers_split:
            part = describe_split_part(len(record.facts.scenes), record.facts.scenes_in_split)
            notes.append(f"{record.facts.split}: {part} only.")
    if any(len({facts.source for facts in record.facts.scene_facts.values()}) < FEW_SCENES for record in records):
        notes.append(FEW_NOTE)
    return notes


def _frames(record: QualityRecord) -> str:
    sizes = sorted({(video.width, video.height) for video in record.videos})
    formats = sorted({name for video in record.videos for name in video.formats})
    return f"{', '.join(f'{width} x {height}' for width, height in sizes)} pixels, {', '.join(formats)}"


def _frame_rate(definition: dict[str, object]) -> str:
    return "2 Hz keyframes" if definition["frames"] == "keyframes" else "12 Hz frames"


def _choose_records(records: Sequence[QualityRecord]) -> list[QualityRecord]:
    """Record with most scenes of each split, in the order of the paper."""
    best: dict[str, QualityRecord] = {}
    for record in sorted(records, key=lambda record: (-len(record.facts.scenes), record.directory.as_posix())):
        best.setdefault(record.facts.split, record)
    return [best[split] for split in sorted(best, key=split_sort_key)]


def _find_kind(record: QualityRecord) -> str:
    facts = record.facts
    weights = {name: used.content for name, used in facts.weights.items()}
    return content_key(facts.definition, weights, facts.device)


def build_sections(records: Sequence[QualityRecord]) -> Iterator[Section]:
    """The tables on video quality, under one heading."""
    names = sorted({record.facts.data.name for record in records})
    for name in names:
        own = [record for record in records if record.facts.data.name == name]
        yield Section.of_tables(name, "video quality", "Video quality" if name == names[0] else "", quality_tables(own))
