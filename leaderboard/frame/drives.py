"""Drives: what was measured, which records may stand beside each other (those of one world), and each as a row."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from benchmark.errors import InputError
from benchmark.metrics.loops import is_stale
from benchmark.metrics.rates import Rate
from benchmark.records.drives import DriveRecord, compute_columns
from benchmark.records.planner_versions import compute_version_labels
from benchmark.records.run_schema import find_source
from benchmark.report.cells import PERCENT, CellSource, TableCell, ValueSource, format_record_name
from leaderboard.frame.rows import (
    FEW_NOTE,
    FEW_SCENES,
    STALE_MARK,
    add_caveat_mark,
    caveat_notes,
    describe_split_part,
    list_planner_marks,
    name_cell,
)

NO_SENSOR: Final = "none"


@dataclass(frozen=True)
class DriveTableRow:
    """A record of drives as a row of a table; `name` is its planner, with its version if its world has several."""

    record: DriveRecord
    name: str

    @property
    def planner(self) -> TableCell:
        """The planner's name with its marks, among them that of earlier scores."""
        cell = add_caveat_mark(name_cell(self.name, self.record.facts.planner), self.record.facts)
        return replace(cell, text=f"{cell.text} {STALE_MARK}") if is_stale(self.record) else cell

    @property
    def origin(self) -> ValueSource:
        """Origin of its numbers."""
        facts = self.record.facts
        return ValueSource(facts.measured.world, format_record_name(self.record.content_id, self.name, facts.split))

    @cached_property
    def rates(self) -> Mapping[str, Rate]:
        """Rates of the record, by column, as they are defined now."""
        return compute_columns(self.record)

    def cell(self, column: str, unit: str = PERCENT) -> CellSource | None:
        """A rate of the record in a unit; ``None`` where it says none."""
        rate = self.rates.get(column)
        if rate is None:
            return None
        return self.origin.percent(rate, "drives") if unit == PERCENT else self.origin.amount(rate, unit, "drives")

    def drives(self) -> CellSource:
        """Number of drives."""
        return self.origin.count(self.record.summary.drives, "drives")


@dataclass(frozen=True)
class ComparableDrives:
    """Records of one measured setting: planners before privileged ones, by name; `name` is a part of a file's name."""

    title: str
    sensor: str
    records: tuple[DriveRecord, ...]
    name: str = ""

    @cached_property
    def rows(self) -> list[DriveTableRow]:
        """Each record with the name of its planner, and what tells its version from others here."""
        ran = [(record.facts.planner, record.facts.data.name, record.facts.split) for record in self.records]
        named = zip(compute_version_labels(ran), self.records, strict=True)
        return [DriveTableRow(record, label or record.planner) for label, record in named]

    @property
    def notes(self) -> list[str]:
        """Notes on the records: sensor, few scenes, marks, old scores."""
        first = self.records[0].facts
        few = len({find_source(name, first.scene_facts) for name in first.scenes}) < FEW_SCENES
        stale = [
            f"{STALE_MARK} {row.name}: scored by version {row.record.facts.scoring} of the closed-loop scores, not the "
            "present one; challenger-bench rescore with the data set scores them anew."
            for row in self.rows
            if is_stale(row.record)
        ]
        marks = list_planner_marks(record.facts.planner for record in self.records)
        lacking = caveat_notes(record.facts for record in self.records)
        whole, few_notes = self._list_whole_scenes(), [FEW_NOTE] if few else []
        return [*self._list_sensor_notes(), *whole, *few_notes, *marks, *lacking, *stale]

    def _list_whole_scenes(self) -> list[str]:
        """Of windows around an encounter: which scenes are driven whole."""
        if self.records[0].facts.measured.window == "scene":
            return []
        windows = (row.window for record in self.records for row in record.rows)
        whole = sorted({window.of for window in windows if window is not None and window.departs_s is None})
        named = f"{', '.join(whole[:3])}{' ...' if len(whole) > 3 else ''}"
        return [f"Driven whole, as nothing says where their adversaries depart: {named}."] if whole else []

    def _list_sensor_notes(self) -> list[str]:
        measured = [record.facts.measured for record in self.records if record.facts.measured.sensor == self.sensor]
        facts = measured[0].sensor_facts if measured else {}
        fact_texts = ", ".join(f"{name} {value}" for name, value in sorted(facts.items()))
        return [f"Sensor {self.sensor}: {fact_texts}."] if fact_texts else []


def group_comparable_drives(records: Sequence[DriveRecord]) -> list[ComparableDrives]:
    """Measured worlds, NeuroNCAP's engines last; planners without cameras stand beside those of every sensor."""
    kinds: dict[str, list[DriveRecord]] = {}
    for record in records:
        facts = record.facts
        review = None if facts.review is None else facts.review.content
        key = [facts.data.name, facts.data.fingerprint, review, facts.split, facts.measured.world, facts.scenes]
        key += [json.dumps(facts.measured.windows_of)]
        kinds.setdefault(json.dumps(key), []).append(record)
    groups = [ComparableDrives(*group_values) for alike in kinds.values() for group_values in _group_by_sensor(alike)]
    for group in groups:
        _require_one_each(group)
    return _name_groups(sorted(groups, key=_sort_key))


def _group_by_sensor(records: Sequence[DriveRecord]) -> list[tuple[str, str, tuple[DriveRecord, ...]]]:
    """Title, sensor and records of each sensor that sees; where there is none, of the blind ones."""
    blind = [drive_record for drive_record in records if drive_record.facts.measured.sensor == NO_SENSOR]
    seeing_records: dict[tuple[str, str], list[DriveRecord]] = {}
    for record in records:
        measured = record.facts.measured
        if measured.sensor != NO_SENSOR:
            facts = json.dumps(measured.sensor_facts, sort_keys=True)
            seeing_records.setdefault((measured.sensor, facts), []).append(record)
    first = records[0].facts
    title = f"{first.data.name} {first.split}: closed loop, engine {first.measured.world}"
    if len(first.scenes) < first.scenes_in_split:
        title += f", {describe_split_part(len(first.scenes), first.scenes_in_split)}"
    if not seeing_records:
        return [(title, NO_SENSOR, _sort_records(blind))]
    groups = []
    for (sensor, _), seeing in sorted(seeing_records.items()):
        looking = {drive_record.planner for drive_record in seeing}
        beside = [drive_record for drive_record in blind if drive_record.planner not in looking]
        groups.append((f"{title}, sensor {sensor}", sensor, _sort_records([*beside, *seeing])))
    return groups


def _sort_key(group: ComparableDrives) -> tuple[bool, str, str, str, list[str], list[str]]:
    facts = group.records[0].facts
    ids = sorted(record.content_id for record in group.records)
    engine = facts.measured.engine != "default"
    return engine, facts.data.name, facts.split, group.title, facts.scenes, ids


def _name_groups(groups: Sequence[ComparableDrives]) -> list[ComparableDrives]:
    """Groups with names that do not depend on what else was measured, unless titles are equal."""
    renamed, name_counts = [], Counter[tuple[str, str]]()
    for group in groups:
        facts, part = group.records[0].facts, not group.records[0].covers_split
        measured = facts.measured
        words = [facts.split, measured.engine.replace("@", "-")]
        words += [measured.agents] if measured.engine == "default" else []
        words += [measured.scenarios] if measured.scenarios != "recorded" else []
        words += [f"{measured.latency_ms}ms"] if measured.latency_ms else []
        words += [] if measured.window == "scene" else [measured.window]
        words += ["as", measured.windows_of["split"]] if measured.windows_of else []
        words += [f"{measured.plan_hz}hz"] if measured.plan_hz != 2 else []
        words += measured.until_words
        words += [group.sensor] if group.sensor != NO_SENSOR else []
        words += ["part"] if part else []
        name = "-".join(words)
        name_counts[facts.data.name, name] += 1
        again = name_counts[facts.data.name, name]
        renamed.append(replace(group, name=f"{name}-{again}" if again > 1 else name))
    return renamed


def _require_one_each(group: ComparableDrives) -> None:
    by_name: dict[str, DriveRecord] = {}
    for row in group.rows:
        first = by_name.setdefault(row.name, row.record)
        if first is not row.record:
            raise InputError(
                f"{first.directory} and {row.record.directory} both hold drives of {row.name} in the same world "
                f"({group.title}); move one of them away or name the records' folder with --records"
            )


def _sort_records(records: Sequence[DriveRecord]) -> tuple[DriveRecord, ...]:
    return tuple(
        sorted(
            records, key=lambda record: (record.facts.planner.privileged, record.planner, record.facts.measured.sensor)
        )
    )
