"""Slices: every sample is where the record says, numbers are those of the slice alone, intervals draw recordings."""

import typing
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmark.cli import options
from benchmark.errors import InputError
from benchmark.metrics.rates import HORIZONS, compute_ratios_over_scenes, sum_by_scene
from benchmark.metrics.scores import map_scenes_to_sources, score_record
from benchmark.metrics.slices import (
    KINDS,
    NOT_STATED,
    SPEEDS,
    SliceKind,
    compute_causes_by,
    compute_driving_by,
    compute_rates_by,
    select_kinds,
    slice_samples,
    sum_by_slice,
)
from benchmark.pdm.totals import DrivenPlan
from benchmark.records.driving import summarise_driving_scores
from benchmark.records.row_schema import DiagnosisRow, SampleRow
from benchmark.records.run import RunRecord, summarise_rows
from benchmark.records.run_schema import SceneFacts
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, LATE, UNCOUNTED, hand_made

SCENES = {
    "a": (HIT, CLEAN, LATE, UNCOUNTED),
    "b": (CLEAN, FAILED, HIT, CLEAN),
    "b-again": (LATE, LATE, CLEAN, CLEAN),
    "c": (CLEAN, CLEAN, CLEAN, HIT),
}
PLACES = ("straight", "junction", "straight", "roundabout")
SPEED = (0.3, 1.0, 5.0, 13.0)
FACTS = {
    "a": SceneFacts(source="a", light=["night", "rain"], manoeuvre="tailgating"),
    "b": SceneFacts(source="b", light=[], manoeuvre="cut-in-left"),
    "b-again": SceneFacts(source="b", light=["day"], manoeuvre="tailgating"),
    "c": SceneFacts(source="c", light=["night"]),
}
DRIVEN = DrivenPlan(
    nc=1.0, dac=1.0, ddc=1.0, ep=1.0, ttc=1.0, lk=1.0, hc=1.0, ec=1.0, forgiven=[],
    progress_m=1.0, recorded_progress_m=1.0, collision_s=None, ttc_s=None,
)  # fmt: skip


def made(**changes: Any) -> RunRecord:
    """A record that says everything; ``changes`` are of every row."""
    record = hand_made("p", SCENES, protocols=("exact", "vad"))
    rows = tuple(
        row.model_copy(
            update={
                **{"place": PLACES[row.index], "speed_m_s": SPEED[row.index], "command": row.index % 3},
                **{name: value(row) if callable(value) else value for name, value in changes.items()},
            }
        )
        for row in record.rows
    )
    return replace(record, rows=rows, run=record.run.model_copy(update={"scene_facts": FACTS}))


def alone(record: RunRecord, chosen: Sequence[int]) -> RunRecord:
    """The same record with some rows and no others."""
    return replace(record, rows=tuple(record.rows[place] for place in chosen))


def members(record: RunRecord, kind: SliceKind) -> dict[str, list[tuple[str, int]]]:
    """Scene and number of the samples of each slice."""
    parts = slice_samples(record, kind)
    assert parts is not None
    return {
        name: [(row.scene, row.index) for row, inside in zip(record.rows, parts.members[:, place]) if inside]
        for place, name in enumerate(parts.names)
    }


def test_the_command_line_knows_every_kind() -> None:
    repeated, _ = typing.get_args(typing.get_args(options.By)[0])
    assert typing.get_args(typing.get_args(repeated)[0]) == KINDS
    assert select_kinds(["speed", "nonsense", "place"]) == ("place", "speed")


def test_every_sample_is_in_the_slices_that_the_record_names_and_in_their_order() -> None:
    record = made()
    by = {kind: members(record, kind) for kind in KINDS}
    assert list(by["place"]) == ["roundabout", "junction", "straight"]
    assert by["place"]["roundabout"] == [(scene, 3) for scene in SCENES]
    assert list(by["speed"]) == list(SPEEDS)
    assert [indices[0][1] for indices in by["speed"].values()] == [0, 1, 2, 3]
    assert list(by["command"]) == ["right", "left", "straight"] and len(by["command"]["right"]) == 8
    scenes = {
        kind: [(name, *sorted({scene for scene, _ in found})) for name, found in by[kind].items()]
        for kind in ("light", "manoeuvre")
    }
    assert sorted(scenes["light"]) == sorted(
        [("day", "b-again"), ("night", "a", "c"), ("rain", "a"), (NOT_STATED, "b")]
    )
    # Frequent ones first.
    assert scenes["manoeuvre"] == [("tailgating", "a", "b-again"), ("cut-in-left", "b"), (NOT_STATED, "c")]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("protocol", ["exact", "vad"])
def test_rates_are_those_of_a_record_with_the_samples_of_the_slice_alone(kind: SliceKind, protocol: str) -> None:
    record = made()
    parts = slice_samples(record, kind)
    assert parts is not None
    found = {one.name: one for one in compute_rates_by(record, kind, protocol)}
    assert found
    for place, name in enumerate(parts.names):
        inside = score_record(alone(record, np.flatnonzero(parts.members[:, place]).tolist()), protocol=protocol)
        counted = int(inside.counted.sum())
        if not counted:
            assert name not in found
            continue
        assert found[name].samples == counted
        assert found[name].scenes == len({scene for scene, one in zip(inside.scenes, inside.counted) if one})
        for column, horizon in enumerate(HORIZONS):
            rate = found[name].columns["collision"][horizon]
            assert rate.value == pytest.approx(inside.values[inside.counted, column].mean())
            assert rate.denominator == counted
            assert found[name].columns["l2"][horizon].value == pytest.approx(1.0)


def test_intervals_draw_recordings_of_the_whole_split() -> None:
    record = made()
    (junction,) = [one for one in compute_rates_by(record, "place", "exact") if one.name == "junction"]
    rows = [row for row in record.rows if row.status == "ok" and row.outcomes["exact"].counted]
    weights = np.array([[float(row.place == "junction")] for row in rows])
    hit = np.array([[float(any(row.outcomes["exact"].collision or ()))] for row in rows])
    sources = map_scenes_to_sources(record)
    (expected,) = compute_ratios_over_scenes(hit * weights, weights, [sources[row.scene] for row in rows], seed=0)
    rate = junction.columns["collision"]["3s"]
    assert (rate.value, rate.low, rate.high) == (expected.value, expected.low, expected.high)
    # The two scenes of one recording are not independent: three recordings, one of which collides there.
    assert rate.low == 0.0 and rate.high is not None and rate.high > rate.value > 0.0  # type: ignore[operator]


def test_driving_scores_of_a_slice_are_those_of_its_samples() -> None:
    def driving(row: SampleRow) -> DrivenPlan | None:
        worse: dict[str, Any] = {"nc": 0.0} if row.scene == "a" else {"ec": None}
        return None if row.status == "failed" else replace(DRIVEN, **worse)

    record = made(driving=driving)
    summary = summarise_rows(record.rows, record.run.protocols, seed=0)
    record = replace(record, summary=summary)
    parts = slice_samples(record, "speed")
    assert parts is not None
    for place, one in enumerate(compute_driving_by(record, "speed")):
        rows = [row for row, inside in zip(record.rows, parts.members[:, place]) if inside and row.driving]
        whole = summarise_driving_scores(rows, [row.scene for row in rows], seed=0)
        assert whole is not None and one.samples == whole.counted
        for column, rates in one.columns.items():
            assert rates["mean"].value == pytest.approx(whole.columns[column]["mean"].value)
    assert compute_driving_by(made(), "speed") == []


def test_causes_are_shares_of_the_colliding_samples() -> None:
    def cause(row: SampleRow) -> DiagnosisRow | None:
        said = {"cause": "unseen" if row.scene == "a" else "misplanned", "reason": "r", "hit": "h"}
        return DiagnosisRow.model_validate({**said, "first_contact_s": 1.0})

    found = {one.name: one for one in compute_causes_by(made(diagnosis=cause), "place")}
    shares = {name: {cause: rate.value for cause, rate in one.columns["cause"].items()} for name, one in found.items()}
    # Straight on: two of the first scene, one each of the two of the second recording.
    assert found["straight"].samples == 4 and found["straight"].scenes == 3
    assert shares["straight"]["unseen"] == shares["straight"]["misplanned"] == 0.5
    assert shares["roundabout"]["misplanned"] == 1.0
    assert compute_causes_by(made(), "place") == []


def test_what_an_old_record_does_not_say_is_in_no_slice_and_nothing_is_guessed() -> None:
    record = made()
    without = {name: facts.model_copy(update={"light": None, "manoeuvre": None}) for name, facts in FACTS.items()}
    old = [replace(record, run=record.run.model_copy(update={"scene_facts": facts})) for facts in (without, {})]
    lacking: dict[SliceKind, list[RunRecord]] = {
        "place": [made(place=None)], "speed": [made(speed_m_s=None)], "light": old, "manoeuvre": old,
    }  # fmt: skip
    for kind, records in lacking.items():
        for each in records:
            assert slice_samples(each, kind) is None and compute_driving_by(each, kind) == []
            assert compute_rates_by(each, kind, "exact") == []
    assert list(members(made(command=7), "command")) == [NOT_STATED]


def test_verdicts_of_another_version_are_refused() -> None:
    record = made()
    stale = replace(record, run=record.run.model_copy(update={"protocols": {"exact": 0}}))
    with pytest.raises(InputError, match="version 0 of protocol exact"):
        compute_rates_by(stale, "place", "exact")
    with pytest.raises(InputError, match="not judged by protocol 'vad'"):
        compute_rates_by(stale, "place", "vad")


@pytest.mark.parametrize("several", [False, True])
def test_sums_of_slices_are_those_of_all_slices_at_once(several: bool) -> None:
    chance = np.random.default_rng(5)
    members = np.eye(3, dtype=np.bool_)[chance.integers(0, 3, 400)]
    members[7, 2] = several or members[7, 2]
    members[9] = False
    values, weights = chance.choice([0.0, 0.1, 0.7, 1e9, 1.0], (400, 4)), chance.integers(0, 2, (400, 4)).astype(float)
    values[:, 1] = chance.random(400) * 30
    scenes = [f"scene-{place}" for place in chance.integers(0, 20, 400).tolist()]
    spread = (weights[:, None, :] * members[:, :, None]).reshape(400, 12)
    slow = sum_by_scene(np.tile(values, (1, 3)) * spread, spread, scenes)
    found = sum_by_slice(members, values, weights, scenes)
    assert found.names == slow.names
    assert found.numerators.tobytes() == slow.numerators.tobytes()
    assert found.denominators.tobytes() == slow.denominators.tobytes()
