"""Links between tables, and chains of rows."""

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Final, TypeVar

from benchmark.datasets.integrity.faults import FaultList
from benchmark.datasets.integrity.tables import CheckedTables, Row
from benchmark.report.words import counted

Key = TypeVar("Key")

# Logs that maps list are left out: the maps of the official v1.0-mini list logs that only v1.0-trainval has.
_LINKS: Final = (
    ("calibrated_sensor", "sensor_token", "sensor"),
    ("instance", "category_token", "category"),
    ("instance", "first_annotation_token", "sample_annotation"),
    ("instance", "last_annotation_token", "sample_annotation"),
    ("sample", "scene_token", "scene"),
    ("sample", "prev", "sample"),
    ("sample", "next", "sample"),
    ("sample_annotation", "sample_token", "sample"),
    ("sample_annotation", "instance_token", "instance"),
    ("sample_annotation", "visibility_token", "visibility"),
    ("sample_annotation", "attribute_tokens", "attribute"),
    ("sample_annotation", "prev", "sample_annotation"),
    ("sample_annotation", "next", "sample_annotation"),
    ("sample_data", "sample_token", "sample"),
    ("sample_data", "ego_pose_token", "ego_pose"),
    ("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
    ("sample_data", "prev", "sample_data"),
    ("sample_data", "next", "sample_data"),
    ("scene", "log_token", "log"),
    ("scene", "first_sample_token", "sample"),
    ("scene", "last_sample_token", "sample"),
)
_MAY_BE_EMPTY: Final = frozenset({"prev", "next", "visibility_token"})


def check_links(tables: CheckedTables, faults: FaultList) -> None:
    """Note links that lead nowhere."""
    for table, field, target in _LINKS:
        if target in tables.unreadable:
            continue
        known = tables.by_token[target]
        for row in tables.having(table, field):
            linked = row[field] if isinstance(row[field], list) else [row[field]]
            for token in linked:
                if token not in known and not (token == "" and field in _MAY_BE_EMPTY):
                    shown = repr(token) if len(token) <= 70 else f"{token[:67]!r}..."
                    sentence = f"{field} {shown} is not in {target}.json"
                    faults.add(f"{field} that lead nowhere", table, row["token"], sentence)


def check_chains(tables: CheckedTables, faults: FaultList) -> None:
    """Note broken chains of samples, sensor rows and annotations, and wrong counts and ends."""
    samples = _grouped(tables.having("sample", "scene_token"), lambda row: str(row["scene_token"]))
    _check_group(tables, "sample", {f"scene {owner}": rows for owner, rows in samples.items()}, faults)
    _check_ends(tables, "scene", ("nbr_samples", "first_sample_token", "last_sample_token"), samples, faults)

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
        sentence = f"its annotations are in {counted(len(scenes), 'scene')}"
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
        now, then = time_of(row), time_of(following)
        if now is not None and then is not None and then <= now:
            sentence = f"next {row['next']} is not later: {then} follows {now}"
            faults.add("chains that go back in time", table, row["token"], sentence)
    heads = [row for row in rows if row["prev"] not in members]
    visited: set[str] = set()
    row_now = heads[0] if heads else rows[0]
    while row_now["token"] not in visited:
        visited.add(row_now["token"])
        row_now = members.get(row_now["next"], row_now)
    if not heads or row_now["next"] in visited:
        faults.add("chains that go round", table, row_now["token"], f"the rows of {owner} go round in a circle")
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
    what = count_field.removeprefix("nbr_")
    for row in tables.having(table, *fields):
        members = chains.get(row["token"], [])
        if row[count_field] != len(members):
            sentence = f"{count_field} is {row[count_field]}, but there are {len(members)} {what} of it"
            faults.add(f"wrong {count_field}", table, row["token"], sentence)
        ends = ((first_field, "prev", "first"), (last_field, "next", "last"))
        for field, link, place in ends:
            end = [member["token"] for member in members if member.get(link) == ""]
            if len(end) == 1 and row[field] != end[0]:
                faults.add(f"wrong {field}", table, row["token"], f"{field} is {row[field]}, the {place} is {end[0]}")
