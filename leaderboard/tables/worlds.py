"""What was measured in closed loop, and which records may stand beside each other: those of one world."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from benchmark.errors import InputError
from benchmark.records.drives import DriveRecord
from benchmark.records.planner_versions import labels
from leaderboard.tables.rows import part_of_split

NO_SENSOR: Final = "none"


@dataclass(frozen=True, slots=True)
class World:
    """One thing that was measured, and who drove in it.

    Attributes:
        title: In words.
        sensor: What the cameras of those saw that look.
        records: Planners before privileged ones, by name.
        name: Part of a file's name.
    """

    title: str
    sensor: str
    records: tuple[DriveRecord, ...]
    name: str = ""

    @property
    def planners(self) -> list[str]:
        """Name of each record's planner, with what tells its version from others here."""
        ran = [(each.facts.planner, each.facts.data.name, each.facts.split) for each in self.records]
        return [label or each.planner for label, each in zip(labels(ran), self.records, strict=True)]


def worlds(records: Sequence[DriveRecord]) -> list[World]:
    """What was measured, each with the records that may stand beside each other.

    Planners that look at nothing stand beside those of every sensor: what cameras see is nothing to them.

    Args:
        records: Of any planners.

    Returns:
        Each with at least one record, NeuroNCAP's engines last.

    Raises:
        InputError: If two records are of one planner in one version.
    """
    kinds: dict[str, list[DriveRecord]] = {}
    for record in records:
        facts = record.facts
        review = None if facts.review is None else facts.review.content
        key = [facts.data.name, facts.data.fingerprint, review, facts.split, facts.measured.world, facts.scenes]
        kinds.setdefault(json.dumps(key), []).append(record)
    found = [World(*each) for alike in kinds.values() for each in _by_sensor(alike)]
    for one in found:
        _require_one_each(one)
    return _named(sorted(found, key=_place))


def _by_sensor(records: Sequence[DriveRecord]) -> list[tuple[str, str, tuple[DriveRecord, ...]]]:
    """Title, sensor and records of each sensor that sees; where there is none, of the blind ones."""
    blind = [each for each in records if each.facts.measured.sensor == NO_SENSOR]
    seen: dict[tuple[str, str], list[DriveRecord]] = {}
    for record in records:
        measured = record.facts.measured
        if measured.sensor != NO_SENSOR:
            facts = json.dumps(measured.sensor_facts, sort_keys=True)
            seen.setdefault((measured.sensor, facts), []).append(record)
    first = records[0].facts
    title = f"{first.data.name} {first.split}: closed loop, engine {first.measured.world}"
    if len(first.scenes) < first.scenes_in_split:
        title += f", {part_of_split(len(first.scenes), first.scenes_in_split)}"
    if not seen:
        return [(title, NO_SENSOR, _in_order(blind))]
    found = []
    for (sensor, _), seeing in sorted(seen.items()):
        looking = {each.planner for each in seeing}
        beside = [each for each in blind if each.planner not in looking]
        found.append((f"{title}, sensor {sensor}", sensor, _in_order([*beside, *seeing])))
    return found


def _place(one: World) -> tuple[bool, str, str, str, list[str], list[str]]:
    facts = one.records[0].facts
    ids = sorted(record.content_id for record in one.records)
    engine = facts.measured.engine != "default"
    return engine, facts.data.name, facts.split, one.title, facts.scenes, ids


def _named(found: Sequence[World]) -> list[World]:
    """With names that do not depend on what else was measured, but for what has the same words."""
    named, seen = [], Counter[tuple[str, str]]()
    for one in found:
        facts, part = one.records[0].facts, not one.records[0].covers_split
        measured = facts.measured
        words = [facts.split, measured.engine.replace("@", "-")]
        words += [measured.agents] if measured.engine == "default" else []
        words += [measured.scenarios] if measured.scenarios != "recorded" else []
        words += [f"{measured.latency_ms}ms"] if measured.latency_ms else []
        words += ["until-fault"] if measured.until == "fault" else []
        words += [one.sensor] if one.sensor != NO_SENSOR else []
        words += ["part"] if part else []
        name = "-".join(words)
        seen[facts.data.name, name] += 1
        again = seen[facts.data.name, name]
        named.append(replace(one, name=f"{name}-{again}" if again > 1 else name))
    return named


def _require_one_each(one: World) -> None:
    by_name: dict[str, DriveRecord] = {}
    for record, name in zip(one.records, one.planners, strict=True):
        first = by_name.setdefault(name, record)
        if first is not record:
            raise InputError(
                f"{first.directory} and {record.directory} both hold drives of {name} in the same world "
                f"({one.title}); move one of them away or name the records' folder with --records"
            )


def _in_order(records: Sequence[DriveRecord]) -> tuple[DriveRecord, ...]:
    """Planners before those that are privileged, by name."""
    return tuple(
        sorted(records, key=lambda each: (each.facts.planner.privileged, each.planner, each.facts.measured.sensor))
    )
