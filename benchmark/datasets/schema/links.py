"""Links between tables, and chains of rows."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence, Set
from itertools import chain
from operator import itemgetter
from typing import TypeVar

from benchmark.datasets.schema import LINKS, FaultList, Link
from benchmark.datasets.schema.rows import Severity, format_value
from benchmark.datasets.schema.table_checks import CheckedTables, Row
from benchmark.report.words import pluralise

Key = TypeVar("Key")


def check_links(tables: CheckedTables, faults: FaultList) -> None:
    """Note links that lead nowhere."""
    known = {table: rows.keys() for table, rows in tables.by_token.items() if table not in tables.unreadable}
    for link in LINKS:
        if link.target in known and link.table in tables.rows:
            check_link(link, list(tables.having(link.table, link.field)), known[link.target], faults)


def check_link(link: Link, rows: Sequence[Row], known: Set[str], faults: FaultList, *, among: str = "") -> None:
    """Note rows whose link leads to none of the ``known`` tokens; ``among`` names which rows these are if not all."""
    values = map(itemgetter(link.field), rows)
    linked = chain.from_iterable(values) if link.field.endswith("_tokens") else values
    if set(linked) - ({""} if link.may_be_empty else set()) <= known:
        return
    for row in rows:
        for token in row[link.field] if isinstance(row[link.field], list) else [row[link.field]]:
            if token not in known and (token or not link.may_be_empty):
                note_dead_link(link, row["token"], token, faults, among=among)


def note_dead_link(link: Link, row_token: str, token: str, faults: FaultList, *, among: str = "") -> None:
    """Note that a row names a token that no row of the other table has, or none among some of its rows."""
    sentence = f"{link.field} {format_value(token)} is not in {link.target}.json{among}"
    faults.add(f"{link.field} that lead nowhere", link.table, row_token, sentence)


def check_sample_chains(tables: CheckedTables, faults: FaultList) -> None:
    """Note scenes without samples, broken chains of samples, and wrong counts and ends of scenes."""
    samples = _grouped(tables.having("sample", "scene_token"), lambda row: str(row["scene_token"]))
    if "sample" not in tables.unreadable:
        for scene in tables.rows["scene"]:
            if scene["token"] not in samples:
                faults.add("scenes without samples", "scene", scene["token"], "no sample belongs to this scene")
    _check_group(tables, "sample", {f"scene {owner}": rows for owner, rows in samples.items()}, faults)
    _check_ends(tables, "scene", ("nbr_samples", "first_sample_token", "last_sample_token"), samples, faults)


def check_chains(tables: CheckedTables, faults: FaultList) -> None:
    """Note broken chains of sensor rows and of annotations, and wrong counts and ends of objects."""

    def channel_of(row: Row) -> str | None:
        sample = tables.get("sample", row["sample_token"], "scene_token")
        calibration = tables.get("calibrated_sensor", row["calibrated_sensor_token"], "sensor_token")
        if sample is None or calibration is None:
            return None
        sensor = tables.get("sensor", calibration["sensor_token"], "channel")
        channel = sensor["channel"] if sensor else f"sensor {calibration['sensor_token']}"
        return f"{channel} of scene {sample['scene_token']}"

    linked = tables.having("sample_data", "sample_token", "calibrated_sensor_token")
    _check_group(tables, "sample_data", _grouped(linked, channel_of), faults)
    objects = _grouped(tables.having("sample_annotation", "instance_token"), lambda row: str(row["instance_token"]))
    _check_group(tables, "sample_annotation", {f"instance {owner}": rows for owner, rows in objects.items()}, faults)
    for instance_token, rows in objects.items():
        _check_object(tables, instance_token, rows, faults)
    fields = ("nbr_annotations", "first_annotation_token", "last_annotation_token")
    _check_ends(tables, "instance", fields, objects, faults)


def _check_object(tables: CheckedTables, instance_token: str, rows: list[Row], faults: FaultList) -> None:
    """Note an instance that is annotated twice at a sample, or in several scenes."""
    scenes: set[str] = set()
    at: set[str] = set()
    for row in rows:
        sample = tables.get("sample", str(row.get("sample_token")), "scene_token")
        if sample is None:
            continue
        scenes.add(sample["scene_token"])
        if row["sample_token"] in at:
            sentence = f"instance {instance_token} has another annotation at sample {row['sample_token']}"
            faults.add("instances annotated twice at a sample", "sample_annotation", row["token"], sentence)
        at.add(row["sample_token"])
    if len(scenes) > 1:
        sentence = f"its annotations are in {pluralise(len(scenes), 'scene')}"
        faults.add("instances of several scenes", "instance", instance_token, sentence)


def _check_group(tables: CheckedTables, table: str, chains: dict[str, list[Row]], faults: FaultList) -> None:
    """Check the chain of each owner whose rows all have links."""
    others = frozenset(row["token"] for rows in chains.values() for row in rows)

    def time_of(row: Row) -> float | None:
        timed: Row | None = tables.get(table, row["token"], "timestamp")
        if table == "sample_annotation":
            timed = tables.get("sample", str(row.get("sample_token")), "timestamp")
        return None if timed is None else timed["timestamp"]

    for owner, rows in chains.items():
        if all(tables.get(table, row["token"], "prev", "next") for row in rows):
            _check_chain(table, owner, rows, others, time_of, faults)


def _grouped(rows: Iterable[Row], key_of: Callable[[Row], Key | None]) -> dict[Key, list[Row]]:
    groups: defaultdict[Key, list[Row]] = defaultdict(list)
    for row in rows:
        key = key_of(row)
        if key is not None:
            groups[key].append(row)
    return groups


def _check_chain(
    table: str,
    owner: str,
    rows: list[Row],
    others: frozenset[str],
    time_of: Callable[[Row], float | None],
    faults: FaultList,
) -> None:
    """Note where rows of one owner do not form one chain in time, linked both ways.

    ``others`` are the rows of all owners: a link to a row that is not there at all has been noted already.
    """
    members = {row["token"]: row for row in rows}
    for row in rows:
        for link in ("prev", "next"):
            if row[link] in others and row[link] not in members:
                sentence = f"{link} {row[link]} is not a row of {owner}"
                faults.add("chains that leave their owner", table, row["token"], sentence)
        following = members.get(row["next"])
        if following is None:
            continue
        if following["prev"] != row["token"]:
            sentence = f"next is {row['next']}, but prev of that row is {following['prev']!r}"
            faults.add("links that are not mutual", table, row["token"], sentence)
        time, next_time = time_of(row), time_of(following)
        if time is not None and next_time is not None and next_time <= time:
            sentence = f"next {row['next']} is not later: {next_time} follows {time}"
            # Readers skip a sweep that is out of order, so the data can still be used.
            swept = table == "sample_data" and not (row.get("is_key_frame") and following.get("is_key_frame"))
            severity: Severity = "warning" if swept else "error"
            faults.add("chains that go back in time", table, row["token"], sentence, severity=severity)
    heads = [row for row in rows if row["prev"] not in members]
    visited: set[str] = set()
    row_now = heads[0] if heads else rows[0]
    while row_now["token"] not in visited:
        visited.add(row_now["token"])
        row_now = members.get(row_now["next"], row_now)
    if not heads or row_now["next"] in visited:
        faults.add("chains that go round", table, row_now["token"], f"the rows of {owner} form a cycle")
    elif len(visited) < len(rows):
        sentence = f"only {len(visited)} of the {len(rows)} rows of {owner} are reached from its first one"
        faults.add("chains in pieces", table, heads[0]["token"], sentence)


def _check_ends(
    tables: CheckedTables,
    table: str,
    fields: tuple[str, str, str],
    chains: dict[str, list[Row]],
    faults: FaultList,
) -> None:
    """Note owners whose count, first or last member is not what their chain has."""
    count_field, first_field, last_field = fields
    member_name = count_field.removeprefix("nbr_").removesuffix("s")
    for row in tables.having(table, *fields):
        members = chains.get(row["token"], [])
        if row[count_field] != len(members):
            held = pluralise(len(members), member_name)
            sentence = f"{count_field} is {row[count_field]}, but the {table} has {held}"
            faults.add(f"wrong {count_field}", table, row["token"], sentence)
        ends = ((first_field, "prev", "first"), (last_field, "next", "last"))
        for field, link, place in ends:
            end = [member["token"] for member in members if member.get(link) == ""]
            if len(end) == 1 and row[field] != end[0]:
                faults.add(f"wrong {field}", table, row["token"], f"{field} is {row[field]}, the {place} is {end[0]}")
