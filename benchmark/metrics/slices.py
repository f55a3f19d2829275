"""The numbers of a record for a part of its samples: by place, light, manoeuvre of the adversary, speed and command.

Slices of a kind share the resamples of their record: recorded scenes are drawn as for the whole, and a scene that has
no sample in a slice adds nothing to it. What a record does not say is not guessed: it is in no slice then.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import find_attributed_collisions, knows_contact_partners, score_adversary_contacts
from benchmark.metrics.rates import HORIZONS, Rate, SceneSums, append_average, compute_ratios_of_sums, sum_by_scene
from benchmark.metrics.scores import map_scenes_to_sources, require_current
from benchmark.protocols import PROTOCOLS, compute_published_values
from benchmark.records.driving import COLUMNS as DRIVING_COLUMNS
from benchmark.records.row_schema import CAUSES, PlaceName
from benchmark.records.run import RunRecord, collect_outcomes, resolve_protocol
from benchmark.records.run_schema import LightName

SliceKind = Literal["place", "light", "manoeuvre", "speed", "command"]
KINDS: Final[tuple[SliceKind, ...]] = get_args(SliceKind)
"""Criteria for slicing samples."""
NOT_STATED: Final = "not said"
ADVERSARY: Final = "adversary"
"""Column of first contacts with an adversary, beside the columns of ``exact``."""
SPEEDS: Final = ("standing", "1 to 5 m/s", "5 to 10 m/s", "10 m/s and more")
SPEED_EDGES_M_S: Final = (1.0, 5.0, 10.0)
"""Speed from which on the next of `SPEEDS` applies; below the first a body stands (docs/manoeuvres.md)."""
COMMANDS: Final = ("right", "left", "straight")
"""By the number of the command."""


@dataclass(frozen=True, slots=True)
class Slicing:
    """K slices that have samples, in the order of tables; ``members`` is (R, K), the record's rows in each.

    A row may be in several (rain at night).
    """

    names: tuple[str, ...]
    members: Bools


@dataclass(frozen=True, slots=True)
class Slice:
    """Numbers of one slice: its samples that count, their scenes, and rates by column and horizon.

    Columns without horizons have other keys there, as causes.
    """

    name: str
    samples: int
    scenes: int
    columns: dict[str, dict[str, Rate]]


def select_kinds(names: Iterable[str]) -> tuple[SliceKind, ...]:
    """Kinds with these names, in the order of `KINDS`; what is none is left out."""
    wanted = set(names)
    return tuple(kind for kind in KINDS if kind in wanted)


def slice_samples(record: RunRecord, kind: SliceKind) -> Slicing | None:
    """Sort the samples of a record into slices; ``None`` where the record does not say.

    Older ones do not know places, speeds and light, and where there is no adversary there is no manoeuvre.
    """
    key = ("slicing", kind)
    # Beside the rows, what the record says of its scenes decides.
    facts, sliced = record.columns.kept.get(key, (None, None))
    if facts is not record.run:
        sliced = _slice_samples(record, kind)
        record.columns.kept[key] = record.run, sliced
    return sliced if sliced is None else cast("Slicing", sliced)


def _slice_samples(record: RunRecord, kind: SliceKind) -> Slicing | None:
    labels = _read_labels(record, kind)
    if labels is None:
        return None
    order = {
        "place": get_args(PlaceName),
        "light": get_args(LightName),
        "manoeuvre": _sort_by_frequency(record),
        "speed": SPEEDS,
        "command": COMMANDS,
    }[kind]
    there = {name for names in labels for name in names}
    names = tuple(name for name in (*order, NOT_STATED) if name in there)
    members = np.array([[name in row_labels for name in names] for row_labels in labels], np.bool_)
    return Slicing(names, members.reshape(-1, len(names)))


def compute_rates_by(record: RunRecord, kind: SliceKind, protocol: str) -> list[Slice]:
    """Every rate of a protocol, or ``native``, slice by slice; empty where `slice_samples` knows none.

    Columns are those of the protocol by horizon, and of ``exact`` with `ADVERSARY` where the split has adversaries and
    the record says whom contacts are with.
    """
    name, parts = resolve_protocol(record, protocol), slice_samples(record, kind)
    require_current(record, name)
    if parts is None:
        return []
    planned, outcomes = record.columns.planned, collect_outcomes(record.rows, name)
    published = compute_published_values(PROTOCOLS[name], outcomes)
    columns = {column: append_average(one).reshape(-1, len(HORIZONS)) for column, one in published.items()}
    if name == EXACT and has_adversaries(record) and knows_contact_partners(record):
        columns[ADVERSARY] = score_adversary_contacts(record).values
    values = np.concatenate(list(columns.values()), axis=1)
    weights = np.where(np.isnan(values), False, outcomes.counted[:, None]).astype(np.float64)
    keys = [(column, horizon) for column in columns for horizon in HORIZONS]
    return _build_slices(record, parts, planned, outcomes.decided, np.nan_to_num(values), weights, keys)


def compute_driving_by(record: RunRecord, kind: SliceKind) -> list[Slice]:
    """The ``mean`` of each column of `benchmark.records.driving`, slice by slice; empty without scores."""
    parts = slice_samples(record, kind)
    chosen = np.flatnonzero(record.columns.flags("driven"))
    if parts is None or record.columns.driving is None or record.summary.driving is None:
        return []
    values, known = record.columns.driving
    keys = [(column, "mean") for column in DRIVING_COLUMNS]
    return _build_slices(record, parts, chosen, np.ones(len(chosen), np.bool_), values, known.astype(np.float64), keys)


def compute_causes_by(record: RunRecord, kind: SliceKind) -> list[Slice]:
    """Share of each ``cause`` among samples that count and collide under ``exact``, slice by slice.

    Empty where nothing collides or the record has no diagnoses.
    """
    require_current(record, EXACT)
    parts = slice_samples(record, kind)
    chosen = np.flatnonzero(find_attributed_collisions(record))
    diagnoses = record.columns.values("diagnosis")
    causes = [None if (diagnosis := diagnoses[place]) is None else diagnosis.cause for place in chosen.tolist()]
    if parts is None or not causes or None in causes:
        return []
    values = np.array([[cause == one for one in CAUSES] for cause in causes], np.float64)
    keys = [("cause", cause) for cause in CAUSES]
    return _build_slices(record, parts, chosen, np.ones(len(chosen), np.bool_), values, np.ones_like(values), keys)


def _build_slices(
    record: RunRecord,
    parts: Slicing,
    chosen: NDArray[np.int64],
    counted: Bools,
    values: Floats,
    weights: Floats,
    keys: Sequence[tuple[str, str]],
) -> list[Slice]:
    """Ratios of S chosen rows with C values each, for every slice in which any of them counts."""
    members, sources = parts.members[chosen], map_scenes_to_sources(record)
    scenes = list(map(record.columns.values("scene").__getitem__, chosen.tolist()))
    rates = compute_ratios_of_sums(
        sum_by_slice(members, values, weights, [sources[scene] for scene in scenes]), seed=record.run.seed
    )
    slices = []
    for place, name in enumerate(parts.names):
        inside = np.flatnonzero(members[:, place] & counted).tolist()
        if not inside:
            continue
        columns: dict[str, dict[str, Rate]] = {}
        for (column, part), rate in zip(keys, rates[place * len(keys) : (place + 1) * len(keys)], strict=True):
            columns.setdefault(column, {})[part] = rate
        slices.append(Slice(name, len(inside), len({scenes[row] for row in inside}), columns))
    return slices


def sum_by_slice(members: Bools, values: Floats, weights: Floats, scenes: Sequence[str]) -> SceneSums:
    """(N, K * C) sums by scene of S samples in K slices, those of the first slice first.

    ``members`` is (S, K), which sample is in which; ``values`` and ``weights`` are (S, C), how often each counts.
    """
    if (members.sum(axis=1) > 1).any():
        # The order of summation depends on all slices that a sample belongs to.
        spread = (weights[:, None, :] * members[:, :, None]).reshape(len(scenes), -1)
        return sum_by_scene(np.tile(values, (1, members.shape[1])) * spread, spread, scenes)
    names = tuple(sorted(set(scenes)))
    sums_of_slices = []
    for inside in members.T:
        rows = np.flatnonzero(inside)
        counting = weights[rows]
        sums = sum_by_scene(values[rows] * counting, counting, [scenes[row] for row in rows.tolist()])
        sums_of_slices.append(sums.over(names))
    numerators, denominators = zip(*((sums.numerators, sums.denominators) for sums in sums_of_slices))
    return SceneSums(names, np.concatenate(numerators, axis=1), np.concatenate(denominators, axis=1))


def _read_labels(record: RunRecord, kind: SliceKind) -> list[tuple[str, ...]] | None:
    """Of each row the slices that it is in; ``None`` where the record does not say."""
    columns = record.columns
    if kind == "command":
        return [(dict(enumerate(COMMANDS)).get(command, NOT_STATED),) for command in columns.values("command")]
    if kind == "place":
        places = columns.values("place")
        return None if None in places else [(str(place),) for place in places]
    if kind == "speed":
        speeds = [np.nan if speed is None else speed for speed in columns.values("speed_m_s")]
        edges = np.searchsorted(SPEED_EDGES_M_S, speeds, side="right").tolist()
        return None if np.isnan(speeds).any() else [(SPEEDS[place],) for place in edges]
    by_scene = _read_lights(record) if kind == "light" else _read_manoeuvres(record)
    return None if by_scene is None else [by_scene[scene] for scene in columns.values("scene")]


def _read_lights(record: RunRecord) -> dict[str, tuple[str, ...]] | None:
    facts = record.run.scene_facts
    light_of_scene = {name: facts[name].light if name in facts else None for name in record.run.scenes}
    if None in light_of_scene.values():
        return None
    return {name: tuple(light or ()) or (NOT_STATED,) for name, light in light_of_scene.items()}


def _read_manoeuvres(record: RunRecord) -> dict[str, tuple[str, ...]] | None:
    facts = record.run.scene_facts
    manoeuvre_of_scene = {name: facts[name].manoeuvre if name in facts else None for name in record.run.scenes}
    if not any(manoeuvre_of_scene.values()):
        return None
    return {name: (manoeuvre or NOT_STATED,) for name, manoeuvre in manoeuvre_of_scene.items()}


def _sort_by_frequency(record: RunRecord) -> tuple[str, ...]:
    """Manoeuvres of the record's scenes, those of many scenes first."""
    counts = Counter(facts.manoeuvre for facts in record.run.scene_facts.values() if facts.manoeuvre is not None)
    return tuple(sorted(counts, key=lambda kind: (-counts[kind], kind)))
