"""The card of results: every rate of run records and of drives as one row, with what it was measured by and on."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from benchmark.constants import VERSION
from benchmark.errors import InputError
from benchmark.extensions.cards.croissant import (
    UNKNOWN,
    DataSetDescription,
    IndexColumn,
    find_licence_page,
    format_column_rows,
    parse_licence,
)
from benchmark.extensions.cards.hub_results import build_hub_files, require_own_files
from benchmark.extensions.cards.writing import (
    CITE,
    CROISSANT_FILE,
    CardSettings,
    WrittenCard,
    format_footer,
    write_card,
)
from benchmark.machine.storage import content_key, write_bytes
from benchmark.metrics.rates import Rate
from benchmark.records.drives import DriveRecord, compute_columns
from benchmark.records.run import RunRecord
from benchmark.report.table import escape_markdown
from benchmark.report.words import pluralise

INDEX_FILE: Final = "rates.parquet"
TAGS: Final = ("autonomous-driving", "nuscenes", "motion-planning", "benchmark", "leaderboard")
RATE_COLUMNS: Final = (
    IndexColumn("data_set", "text", "name of the data set"),
    IndexColumn("data_content", "text", "hash of its content"),
    IndexColumn("split", "text", "split"),
    IndexColumn("frozen_split", "text", "frozen split that it was built from, if any"),
    IndexColumn("planner", "text", "name of the planner"),
    IndexColumn("privileged", "truth", "whether it saw boxes, the map or the recorded future"),
    IndexColumn("miniature", "truth", "whether it is a small stand-in, not for ranking"),
    IndexColumn("weights_sha256", "text", "hash of its weights, if it has any"),
    IndexColumn("loop", "text", "open (plans judged against the recording) or closed (plans driven)"),
    IndexColumn("protocol", "text", "definition: a protocol, nuscenes-pdm, or engine and agents of a drive"),
    IndexColumn("protocol_version", "count", "its version"),
    IndexColumn("column", "text", "measured quantity: collision, l2, ..."),
    IndexColumn("horizon", "text", "1s, 2s, 3s, avg, ...; null of drives"),
    IndexColumn("value", "number", "mean or rate; null if no samples counted"),
    IndexColumn("low", "number", "lower end of the 95 % interval over recorded scenes"),
    IndexColumn("high", "number", "upper end"),
    IndexColumn("numerator", "number", "sum over the counted samples or drives"),
    IndexColumn("denominator", "number", "number of samples or drives counted"),
    IndexColumn("coverage", "number", "share of samples or drives on which the planner did not fail"),
    IndexColumn("scenes", "count", "number of scenes run"),
    IndexColumn("scenes_in_split", "count", "number of scenes in the split"),
    IndexColumn("record", "text", "content id of the record"),
)


def rate_rows(records: Sequence[RunRecord], drives: Sequence[DriveRecord]) -> Iterator[dict[str, Any]]:
    """Rows of `RATE_COLUMNS`, one for each rate, record by record."""
    for record in records:
        whose = {**_planner_columns(record.run, record.content_id), "loop": "open", "coverage": record.summary.coverage}
        measured = [
            (name, protocol_summary.version, protocol_summary.columns)
            for name, protocol_summary in record.summary.protocols.items()
        ]
        if record.summary.driving is not None:
            measured.append(("nuscenes-pdm", record.summary.driving.version, record.summary.driving.columns))
        for protocol, version, columns in measured:
            by = {"protocol": protocol, "protocol_version": version}
            for column, rates in columns.items():
                for horizon, rate in rates.items():
                    yield {**whose, **by, "column": column, "horizon": horizon, **_rate_columns(rate)}
    for drive in drives:
        facts = drive.facts
        whose = {**_planner_columns(facts, drive.content_id), "loop": "closed", "coverage": drive.summary.coverage}
        by = {"protocol": facts.measured.world, "protocol_version": facts.scoring, "horizon": None}
        for column, rate in compute_columns(drive).items():
            yield {**whose, **by, "column": column, **_rate_columns(rate)}


def write_records_card(
    records: Sequence[RunRecord], drives: Sequence[DriveRecord], to: Path, settings: CardSettings | None = None
) -> WrittenCard:
    """Write ``README.md``, ``rates.parquet`` and ``croissant.json`` of results, and with ``settings.hub`` files for it.

    Args:
        records: Of planning.
        drives: Of driving.
        to: Folder.
        settings: Facts that the records themselves do not hold.

    Returns:
        The written files.

    Raises:
        InputError: If there are no records, none of what ``settings.hub`` names, or the folder cannot be written.
    """
    settings = settings or CardSettings()
    rows = list(rate_rows(records, drives))
    if not rows:
        raise InputError("there are no records with numbers to describe; run challenger-bench eval first")
    count = len(records) + len(drives)
    description = (
        f"{pluralise(len(rows), 'rate')} from {pluralise(count, 'record')} of driving models on adversarial and "
        "ordinary scenes, each by a named, versioned protocol, with its sample count and interval."
    )
    card_description = DataSetDescription(
        name=settings.title or "challenger-bench results",
        description=description,
        licence=parse_licence(settings.licence),
        url=settings.url,
        published=settings.day,
        version=f"1.0.0+{content_key(sorted({row['record'] for row in rows}))[:12]}",
        cite=CITE,
        creator=settings.creator,
        keywords=TAGS,
        responsible=_build_responsible_ai(records, drives),
    )
    page = _format_page(card_description, records, drives)
    hub = None if settings.hub is None else build_hub_files(records, drives, settings, (INDEX_FILE,))
    if hub is not None:
        require_own_files(to, hub.files)
    written = write_card(to, card_description, page, INDEX_FILE, "rates", RATE_COLUMNS, rows, TAGS)
    if hub is None:
        return written
    for place, data in hub.files.items():
        write_bytes(to / place, data)
    return replace(written, files=(*written.files, *(to / place for place in hub.files)), left_out=hub.left_out)


def _planner_columns(facts: Any, content_id: str) -> dict[str, Any]:
    planner = facts.planner
    return {
        "data_set": facts.data.name,
        "data_content": facts.data.fingerprint,
        "split": facts.split,
        "frozen_split": facts.frozen_split,
        "planner": planner.name,
        "privileged": planner.privileged,
        "miniature": planner.miniature,
        "weights_sha256": planner.weights_sha256,
        "scenes": len(facts.scenes),
        "scenes_in_split": facts.scenes_in_split,
        "record": content_id,
    }


def _rate_columns(rate: Rate) -> dict[str, Any]:
    return {name: getattr(rate, name) for name in ("value", "low", "high", "numerator", "denominator")}


def _build_responsible_ai(
    records: Sequence[RunRecord], drives: Sequence[DriveRecord]
) -> dict[str, str | tuple[str, ...]]:
    failed = sum(record.summary.failed for record in records) + sum(record.summary.failed for record in drives)
    parts = sum(not record.covers_split for record in records) + sum(not record.covers_split for record in drives)
    return {
        "dataCollection": f"Planners were run and scored by challenger-bench ({VERSION} wrote this card).",
        "dataCollectionType": ("Experiments", "Software Collection"),
        "dataCollectionMissingData": f"{pluralise(failed, 'sample or drive', 'samples or drives')} on which a planner "
        f"failed are left out of all rates; {pluralise(parts, 'record')} covering only part of a split.",
        "dataAnnotationProtocol": "None: numbers are computed from stored plans.",
        "dataBiases": ("A rate holds for these scenes only.",),
        "dataLimitations": (
            "Rates of different protocols are not comparable, even under the same name.",
            "Rates on adversarial scenes depend on the search that found them.",
            "Miniatures are small stand-ins, not for ranking.",
        ),
        "dataUseCases": ("Comparing planners on the same split under the same protocol and version.",),
        "dataSocialImpact": "A low rate here does not show that a planner is safe.",
        "personalSensitiveInformation": ("None.",),
        "dataReleaseMaintenancePlan": "The version ends in a hash of the records, so it changes with the records.",
    }


def _format_page(
    description: DataSetDescription, records: Sequence[RunRecord], drives: Sequence[DriveRecord]
) -> list[str]:
    rows = [
        (
            "open",
            record.planner,
            record.run.data.name,
            record.run.split,
            len(record.rows),
            record.summary.coverage,
            record.content_id,
        )
        for record in records
    ] + [
        (
            "closed",
            record.planner,
            record.facts.data.name,
            record.facts.split,
            len(record.rows),
            record.summary.coverage,
            record.content_id,
        )
        for record in drives
    ]
    licence = (
        "Undecided: the publisher must choose one."
        if description.licence == UNKNOWN
        else f"{description.licence} ({find_licence_page(description.licence)})."
    )
    lines = [
        f"# {escape_markdown(description.name)}",
        "",
        escape_markdown(description.description),
        "",
        f"Licence: {escape_markdown(licence)}",
        "",
        "| loop | planner | data set | split | samples or drives | coverage | record |",
        "|---|---|---|---|---|---|---|",
    ]
    for loop, planner, name, split, count, coverage, content in rows:
        cells = (loop, escape_markdown(planner), escape_markdown(name), escape_markdown(split), f"{count:,}")
        lines.append(f"| {' | '.join(cells)} | {100 * coverage:.1f} % | `{content}` |")
    lines += [
        "",
        "## Index",
        "",
        f"`{INDEX_FILE}` has one row a rate; `{CROISSANT_FILE}` describes it for machines.",
        "",
    ]
    lines += [*format_column_rows(RATE_COLUMNS), "", "## Before you use it", ""]
    for field in ("dataUseCases", "dataLimitations", "dataBiases", "dataCollectionMissingData"):
        answer = description.responsible[field]
        lines += [f"- {escape_markdown(text)}" for text in ((answer,) if isinstance(answer, str) else answer)]
    return [*lines, "", *format_footer()]
