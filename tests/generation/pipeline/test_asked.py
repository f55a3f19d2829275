"""Builds that ask for manoeuvres, and variants that differ."""

import contextlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet
from benchmark.records.attempts import Attempt, ClosestApproach, ManoeuvreLabels, ManoeuvreOccurrence
from generation.labels.manoeuvres import Manoeuvre
from generation.pipeline.selection import compute_distance, select_differing
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.search.attempts import StoredAttempt
from generation.search.chains import AdversaryChain, SearchAttempt
from generation.search.definition import SearchUnit
from tests.generation.labels.recorded_roads import CHEAP, contents, recorded, write_source

ASKED = (Manoeuvre.TAILGATING, Manoeuvre.SQUEEZING_LEFT, Manoeuvre.ONCOMING)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_source(tmp_path_factory.mktemp("recorded"), recorded("scene-9901"), recorded("scene-9902"))


def build(source: DataSet, settings: BuildSettings) -> None:
    # What was tried is written even where nothing survives.
    with contextlib.suppress(NothingSurvivedError):
        build_split(source, "adv", settings)


def test_the_report_says_what_was_asked_tried_and_kept(source: DataSet, tmp_path: Path) -> None:
    once = replace(CHEAP, out=tmp_path / "out", asked=ASKED, limit=1, hyper=replace(CHEAP.hyper, tries=1))
    build(source, once)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    rows = [json.loads(line) for line in (tmp_path / "out" / "attempts.jsonl").read_text().splitlines()]
    assert set(report["requests"]) == {kind.value for kind in ASKED}
    for kind, counts in report["requests"].items():
        mine = [row for row in rows if row["asked"] == kind]
        kept = [row for row in mine if row["kept"]]
        assert counts["tried"] == len(mine) and counts["kept"] == len(kept)
        assert counts["asked"] == report["requests"]["tailgating"]["asked"]
        assert all(row["labels"]["manoeuvre"] == kind for row in kept)
    # Everybody drives the ego's way.
    assert report["requests"]["oncoming"]["tried"] == 0 < report["requests"]["tailgating"]["tried"]
    assert report["tried"] == len(rows)
    build(source, replace(once, out=tmp_path / "again", together=3))
    assert contents(tmp_path / "again") == contents(tmp_path / "out")


def test_nothing_of_a_build_changes_where_nothing_is_asked_and_variants_of_it(source: DataSet, tmp_path: Path) -> None:
    whole = build_split(source, "adv", replace(CHEAP, out=tmp_path)).written
    assert json.loads((tmp_path / "report.json").read_text())["requests"] == {}
    assert all("asked" not in json.loads(line) for line in (tmp_path / "attempts.jsonl").read_text().splitlines())
    assert "asked" not in json.loads((tmp_path / "search.json").read_text())
    written = build_split(source, "adv", replace(CHEAP, out=tmp_path, variants=1)).written
    assert len(written) == len({name.rsplit("-", 1)[0] for name in written}) < len(whole)


def _kept(name: str, offset_m: float, kind: Manoeuvre, challenge: float) -> AdversaryChain:
    """A chain of one adversary that drives straight on, so far to the left."""
    poses = tuple((float(x), offset_m, 0.0) for x in range(60))
    labels = ManoeuvreLabels(
        manoeuvre=kind.value,
        occurred=(ManoeuvreOccurrence(kind=kind.value, first_s=0.0, duration_s=1.0, least_gap_m=1.0),),
        closest_approach=ClosestApproach(gap_m=1.0, frame=0, time_s=0.0, side="left"),
        time_to_collision=None,
        encroachment=None,
        place="straight",
    )
    report = Attempt(
        scene="scene", agent=name, seed=0, kept=True, discard=None, launch_frame=0, challenge=challenge,
        closest_approach=None, least_time_to_collision_s=None, labels=labels, plans=(),
    )  # fmt: skip
    unit = SearchUnit("scene", 0, name)
    return AdversaryChain("scene", (SearchAttempt(unit, name, StoredAttempt(agent=0, report=report, poses=poses)),))


def _names(chains: Sequence[AdversaryChain]) -> list[str]:
    return [chain.agent_id for chain in chains]


def test_variants_are_those_that_differ_and_not_the_best_ones() -> None:
    order = [
        _kept("best", 3.0, Manoeuvre.SQUEEZING_LEFT, 0.9),
        _kept("same again", 3.2, Manoeuvre.SQUEEZING_LEFT, 0.8),
        _kept("same once more", 3.1, Manoeuvre.SQUEEZING_LEFT, 0.7),
        _kept("connection that", -3.0, Manoeuvre.SQUEEZING_RIGHT, 0.3),
        _kept("behind", 0.0, Manoeuvre.TAILGATING, 0.2),
    ]
    assert _names(select_differing(order, 1)) == ["best"]
    assert _names(select_differing(order, 2)) == ["best", "connection that"]
    assert _names(select_differing(order, 3)) == ["best", "connection that", "behind"]
    assert _names(select_differing(order, 9)) == _names(order)


def test_distance_is_a_number_between_0_and_2_and_the_same_both_ways() -> None:
    chains = [_kept("a", 0.0, Manoeuvre.LEADING, 0.1), _kept("b", 4.0, Manoeuvre.LEADING, 0.1)]
    chains.append(_kept("c", 400.0, Manoeuvre.CROSSING, 0.1))
    links = [chain.links[0] for chain in chains]
    values = np.array([[compute_distance(first, second) for second in links] for first in links])
    np.testing.assert_allclose(values, values.T)
    np.testing.assert_allclose(values, [[0.0, 0.4, 2.0], [0.4, 0.0, 2.0], [2.0, 2.0, 0.0]])
