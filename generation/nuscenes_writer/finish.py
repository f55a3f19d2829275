"""Putting written scenes together: tables, maps, splits and provenance of each root."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmark.constants import CAMERA_NAMES, NUSCENES_TABLES
from benchmark.datasets.categories import NAMES_FILE, SENSOR
from benchmark.datasets.drawn_later import DRAWN_BY
from benchmark.datasets.scene_assessments import ASSESSMENTS_FILE
from benchmark.datasets.scene_names import NAME, PROVENANCE, SHIFT_US
from benchmark.datasets.split_reviews import LEFT_OUT
from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, write_bytes, write_json, writing_to
from benchmark.records.attempts import EGO, PANEL, SEARCH
from benchmark.records.seed_splits import RECORDED_EGO
from generation.nuscenes_writer.maps import write_maps
from generation.nuscenes_writer.plan import DataSetPlan, require_own_root
from generation.nuscenes_writer.scenes import NUMBER, place_file, read_state, read_stored_fragment, release_claim
from generation.nuscenes_writer.vocabulary import LabelVocabulary, Row, build_sensor_rows

PROVENANCE_SCHEMA: Final = 1
STATE_FOLDERS: Final = ("attempts", "claims", "fragments", "judgements", "maps", "rounds", "surveys")
"""Where unfinished files may lie below the writer's own folder."""

Fragment = dict[str, Any]


def finish_data_set(
    plan: DataSetPlan, keys: Sequence[str], *, extra_splits: Mapping[str, Sequence[str]] | None = None
) -> None:
    """Merge written scenes into complete roots; ``challenger.json`` is written last and marks a finished root.

    Scenes that were written here earlier and are not named are removed. Running it twice gives the same bytes.

    Args:
        plan: The data set.
        keys: Return values of `write_scene`, in the order of the scenes in the tables.
        extra_splits: Scene names by further split. These scenes are not in ``plan.split``, unless that is given here as
            well.

    Raises:
        InputError: If there are no keys, a key was never written, two scenes have the same name, files or instances,
            a split names an unknown scene, or the disk refuses.
    """
    if not keys:
        raise InputError(f"there are no scenes to write to {plan.root}; nothing was changed")
    fragments = [_read_fragment(plan, key) for key in dict.fromkeys(keys)]
    roots: dict[int, list[Fragment]] = {}
    for fragment in fragments:
        roots.setdefault(fragment["variant"] if plan.layout == "per-variant" else 0, []).append(fragment)
    for variant, members in sorted(roots.items()):
        require_own_root(plan, variant)
        _require_distinct(members)
    splits = _build_splits(plan, [fragment["name"] for fragment in fragments], extra_splits or {})
    for root in _list_roots(plan, roots):
        with writing_to(root):
            (root / plan.version / PROVENANCE).unlink(missing_ok=True)
    _remove_stale(plan, roots)
    vocabulary = LabelVocabulary.of(plan.source)
    for variant, members in sorted(roots.items()):
        _write_root(plan, plan.data_root(variant), vocabulary, members, splits)
    _remove_temporary_files(plan, roots)
    for variant, members in sorted(roots.items()):
        provenance = _build_provenance(plan, members) | _describe_left_out(plan, variant, sorted(roots))
        write_json(plan.data_root(variant) / plan.version / PROVENANCE, provenance)


def _read_fragment(plan: DataSetPlan, key: str) -> Fragment:
    fragment = read_stored_fragment(plan, key)
    if fragment is None:
        raise InputError(f"scene {key[:12]} of {plan.root} is not written; run the command that builds it again")
    return fragment


def _require_distinct(members: Sequence[Fragment]) -> None:
    names: set[str] = set()
    owners: dict[str, dict[str, str]] = {"numbers": {}, "files": {}, "instances": {}}
    for fragment in members:
        name = fragment["name"]
        if name in names:
            raise InputError(f"two scenes have the name {name}; give each its own name or use another variant")
        names.add(name)
        for kind, known in owners.items():
            for item in [_find_row_name(fragment)] if kind == "numbers" else fragment[kind]:
                if item in known:
                    raise InputError(
                        f"{known[item]} and {name} share {kind[:-1]} {item}; scenes of one data set need logs or times "
                        "and instances that they do not share: rename their logs or identifiers"
                    )
                known[item] = name


def _build_splits(plan: DataSetPlan, names: Sequence[str], extra: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    for split, members in extra.items():
        unknown = sorted(set(members) - set(names))
        if unknown:
            raise InputError(f"split {split} names scene {unknown[0]}, which is not among the scenes of {plan.root}")
    taken = {name for members in extra.values() for name in members}
    own = {plan.split: [name for name in dict.fromkeys(names) if name not in taken]}
    return {**own, **{split: list(members) for split, members in extra.items()}}


def _list_roots(plan: DataSetPlan, roots: Mapping[int, Any]) -> list[Path]:
    variants = set(roots) | {claim["variant"] for claim in _read_claims(plan).values()}
    return sorted({plan.data_root(variant) for variant in variants})


def _read_claims(plan: DataSetPlan) -> dict[Path, dict[str, Any]]:
    claims = {path: read_state(path) for path in sorted((plan.state / "claims").glob("*.json"))}
    return {path: claim for path, claim in claims.items() if claim is not None}


def _remove_stale(plan: DataSetPlan, roots: Mapping[int, Sequence[Fragment]]) -> None:
    """Remove scenes that are no longer part of the data set, and roots that have none left."""
    current_keys = {fragment["key"] for members in roots.values() for fragment in members}
    used = {
        plan.data_root(variant): frozenset(
            name for fragment in members for path in fragment["files"] for name in (path, place_file(fragment, path))
        )
        for variant, members in roots.items()
    }
    for path, claim in _read_claims(plan).items():
        if claim["key"] not in current_keys:
            root = plan.data_root(claim["variant"])
            release_claim(plan, claim, used.get(root, frozenset()))
            with writing_to(path):
                path.unlink()
            if root not in used:
                _remove_root(plan, root)
    maps = {fragment["map"] for members in roots.values() for fragment in members}
    for folder, names in (("fragments", current_keys), ("judgements", current_keys), ("maps", maps)):
        for path in sorted((plan.state / folder).glob("*.json")):
            if path.stem not in names:
                with writing_to(path):
                    path.unlink()


def _remove_root(plan: DataSetPlan, root: Path) -> None:
    """Remove what finishing wrote to a root, and the folders that are empty then."""
    with writing_to(root):
        for table in (*NUSCENES_TABLES, "splits"):
            (root / plan.version / f"{table}.json").unlink(missing_ok=True)
        for name in (ASSESSMENTS_FILE, NAMES_FILE):
            (root / plan.version / name).unlink(missing_ok=True)
        shutil.rmtree(root / "maps", ignore_errors=True)
        shutil.rmtree(plan.drawn_path(root), ignore_errors=True)
        folders = [root / plan.version, *(root / kind for kind in ("samples", "sweeps", "can_bus")), root]
        for folder in folders:
            for empty in (*folder.glob("*/"), folder):
                if empty.is_dir() and not any(empty.iterdir()):
                    empty.rmdir()


def _write_root(
    plan: DataSetPlan,
    root: Path,
    vocabulary: LabelVocabulary,
    members: Sequence[Fragment],
    splits: Mapping[str, Sequence[str]],
) -> None:
    _place_files(root, members)
    logs, maps = write_maps(plan, root, vocabulary, members)
    files = (Path(path).parts for fragment in members for path in fragment["files"])
    channels = {parts[1] for parts in files if parts[0] == "samples"}
    shared: dict[str, list[Row]] = {
        "sensor": build_sensor_rows(channels),
        "category": _merge_labels(vocabulary.category, members, "category"),
        "attribute": _merge_labels(vocabulary.attribute, members, "attribute"),
        "visibility": list(vocabulary.visibility),
        "log": logs,
        "map": maps,
    }
    folder = root / plan.version
    for table in NUSCENES_TABLES:
        if table in shared:
            lines = list(map(canonical_json, shared[table]))
        else:
            lines = [fragment["tables"][table] for fragment in members if fragment["tables"][table]]
        write_bytes(folder / f"{table}.json", ("[\n" + ",\n".join(lines) + "\n]\n").encode())
    rows = {fragment["name"]: _find_row_name(fragment) for fragment in members}
    present = {split: [rows[name] for name in names if name in rows] for split, names in splits.items()}
    write_json(folder / "splits.json", present)
    views = channels.intersection(CAMERA_NAMES)
    if plan.source is not None and views and any(name.startswith(SENSOR) for name, _ in plan.source.names):
        # Records of the split say of its rig what those of the source say.
        write_json(folder / NAMES_FILE, {"cameras": "nuscenes"})
    else:
        (folder / NAMES_FILE).unlink(missing_ok=True)


def _place_files(root: Path, members: Sequence[Fragment]) -> None:
    """Give files the names that they have in a finished root."""
    for fragment in members:
        for path in fragment["files"]:
            place = root / place_file(fragment, path)
            if place != root / path and (root / path).is_file():
                with writing_to(place):
                    (root / path).replace(place)


def _find_row_name(fragment: Fragment) -> str:
    """Name of a scene in the tables."""
    return str(fragment.get(NUMBER, fragment)["name"])


def _describe_scene(fragment: Fragment) -> dict[str, Any]:
    made = {name: fragment[name] for name in ("source_scene", "adversaries", "report")}
    if NUMBER not in fragment:
        return made
    return {NAME: fragment["name"], SHIFT_US: fragment[NUMBER]["shift_us"], **made}


def _merge_labels(known: Mapping[str, Row], members: Sequence[Fragment], table: str) -> list[Row]:
    used = {row["name"]: row for fragment in members for row in fragment["labels"][table]}
    return [*known.values(), *(row for name, row in sorted(used.items()) if name not in known)]


def _build_provenance(plan: DataSetPlan, members: Sequence[Fragment]) -> dict[str, Any]:
    source = None if plan.source is None else {"name": plan.source.name, "fingerprint": plan.source.fingerprint}
    scenes = {_find_row_name(fragment): _describe_scene(fragment) for fragment in members}
    provenance = {
        "schema": PROVENANCE_SCHEMA,
        "split": plan.split,
        "source": source,
        "renderer": members[0]["renderer"],
        "scenes": scenes,
    }
    if plan.drawn_by is not None:
        provenance[DRAWN_BY] = plan.drawn_by
    if plan.frozen is not None:
        provenance["frozen"] = dict(zip(("name", "content"), plan.frozen, strict=True))
    if plan.search is not None:
        provenance[SEARCH] = plan.search
    if plan.panel:
        provenance[PANEL] = plan.panel
    if plan.ego != RECORDED_EGO:
        provenance[EGO] = plan.ego
    return provenance


def _describe_left_out(plan: DataSetPlan, variant: int, written: Sequence[int]) -> dict[str, Any]:
    """Facts on scenes that an inspector rejected: a root's own, and in the first one those of roots without any."""
    left_out = {}
    for number, judged in plan.left_out:
        own = plan.layout == "suffixed" or number == variant
        if own or (variant == written[0] and number not in written):
            name = judged.name.removeprefix(f"v{variant}/") if plan.layout == "per-variant" else judged.name
            left_out[name] = {"token": judged.token, "reason": judged.reason}
    return {LEFT_OUT: left_out} if left_out else {}


def _remove_temporary_files(plan: DataSetPlan, roots: Mapping[int, Any]) -> None:
    folders = [plan.root, plan.state, *(plan.state / name for name in STATE_FOLDERS)]
    for variant in roots:
        root = plan.data_root(variant)
        folders += [plan.drawn_path(root), root / plan.version, root / "can_bus", *sorted(root.glob("maps/**/"))]
        folders += [*sorted(root.glob("samples/*/")), *sorted(root.glob("sweeps/*/"))]
    for folder in folders:
        for path in sorted(folder.glob(".*.part")):
            with writing_to(path):
                path.unlink()
