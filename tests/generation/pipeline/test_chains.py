"""Several adversaries in one scene: each planned in the scene that the ones before it made."""

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.dynamics.bicycle import MotionModel
from benchmark.geometry import boxes_overlap
from benchmark.machine.workers import LocalProcesses
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.search.adversary import does_ego_already_collide
from generation.search.chains import DropReason, search_chains
from generation.search.definition import Search
from generation.search.hyperparameters import HyperParameters
from generation.search.verify import DiscardReason, VerificationFailure, verify
from tests.generation.labels.recorded_roads import QUICK, contents, recorded, write_source
from tests.generation.search.driving_prior import DrivingPrior
from tests.hand_made import Car

PAIRS = replace(QUICK, adversaries=2)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_source(
        tmp_path_factory.mktemp("recorded"), recorded("scene-9901"), recorded("scene-9902", seconds=9.0)
    )


@pytest.fixture(scope="module")
def built(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("pairs") / "out"
    build_split(source, "adv", replace(PAIRS, out=out))
    return out


def rows_of(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "attempts.jsonl").read_text().splitlines()]


def search_in(source: DataSet, out: Path) -> Search:
    prior = DrivingPrior()
    return Search(
        source.fingerprint(), QUICK.hyper, 0, DrivingPrior, prior.fingerprint, out / ".challenger", out / "timings"
    )


def test_each_scene_has_two_adversaries_that_touch_nothing(source: DataSet, built: Path) -> None:
    data = open_data(built)
    names = data.scene_names("adv")
    assert len(names) >= 2
    for name in names:
        scene = data.scene(name)
        assert len(scene.adversaries) == 2
        assert not does_ego_already_collide(scene)
        first, second = (scene.agents.ids.index(adversary) for adversary in scene.adversaries)
        assert not boxes_overlap(scene.agents.boxes[first], scene.agents.boxes[second]).any()


def test_the_first_adversary_still_passes_beside_the_second(source: DataSet, built: Path) -> None:
    limits = MotionModel.si().limits
    assert limits is not None
    found = search_chains(search_in(source, built), source, source.scene_names("val"), LocalProcesses(1), adversaries=2)
    assert found.chains
    for chain in found.chains:
        scene = chain.adversarial(source.scene(chain.scene_name))
        for link in chain.earlier:
            assert verify(scene, link.agent, link.start, QUICK.hyper, limits) is None
        assert scene.adversaries == chain.agent_ids


def test_every_attempt_is_accounted_for(built: Path) -> None:
    report, rows = json.loads((built / "report.json").read_text()), rows_of(built)
    assert report["adversaries"] == 2
    assert report["tried"] == len(rows)
    assert report["discarded"] == Counter(row["discard"] for row in rows if row["discard"])
    assert report["dropped"] == Counter(row["dropped"] for row in rows if row["dropped"])
    assert {reason for row in rows if (reason := row["dropped"])} <= set(DropReason)
    written = Counter(row["written"] for row in rows if row["written"])
    assert written == dict.fromkeys(report["written"], 2)
    for row in rows:
        assert sum(bool(row[fate]) for fate in ("discard", "dropped", "written")) == 1


def test_only_the_most_challenging_next_adversary_is_kept(built: Path) -> None:
    second = [row for row in rows_of(built) if row["earlier"] and row["kept"]]
    for chosen in (row for row in second if row["written"]):
        rivals = [row for row in second if (row["scene"], row["earlier"]) == (chosen["scene"], chosen["earlier"])]
        assert chosen["challenge"] == max(row["challenge"] for row in rivals)


def test_the_data_set_says_who_the_adversaries_are(built: Path) -> None:
    said = (open_data(built).provenance() or {})["scenes"]
    rows = rows_of(built)
    for name, entry in said.items():
        assert len(entry["adversaries"]) == 2
        mine = [row["agent"] for row in rows if row["written"] == name]
        assert [report["agent"] for report in entry["report"]["adversaries"]] == mine


def test_names_depend_on_the_adversaries_and_not_on_the_rank(source: DataSet, built: Path, tmp_path: Path) -> None:
    names = set(open_data(built).scene_names("adv"))
    out = Path(shutil.copytree(built, tmp_path / "out"))
    build_split(source, "adv", replace(PAIRS, out=out, total=1))
    assert set(open_data(out).scene_names("adv")) < names
    # What was found for single adversaries is the first half of pairs: nothing is tried twice.
    singles = build_split(source, "adv", replace(QUICK, out=tmp_path / "singles"))
    assert not set(singles.written) & names
    tried, of_pairs = (
        {path.name for path in (out / ".challenger" / "attempts").iterdir()} for out in (tmp_path / "singles", built)
    )
    assert tried < of_pairs


def test_two_workers_and_a_killed_build_give_the_same_bytes(source: DataSet, built: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    build_split(source, "adv", replace(PAIRS, out=out, executor=LocalProcesses(2)))
    assert contents(out) == contents(built)
    for folder in ("attempts", "surveys"):
        for path in sorted((out / ".challenger" / folder).iterdir())[::2]:
            path.unlink()
    (out / "v1.0-mini" / "challenger.json").unlink()
    build_split(source, "adv", replace(PAIRS, out=out))
    assert contents(out) == contents(built)


def test_too_few_vehicles_is_a_reason(tmp_path: Path) -> None:
    lonely = write_source(tmp_path / "source", recorded("scene-9903", (Car(62.0, 194.75, 9.0),)))
    with pytest.raises(NothingSurvivedError, match="too-few-adversaries"):
        build_split(lonely, "adv", replace(PAIRS, out=tmp_path / "out"))
    rows = rows_of(tmp_path / "out")
    assert [row["dropped"] for row in rows] == [DropReason.TOO_FEW_ADVERSARIES]


def test_no_vehicle_to_try_is_counted_by_reason(tmp_path: Path) -> None:
    parked = write_source(tmp_path / "source", recorded("scene-9903", (Car(62.0, 204.0, 0.0),)))
    with pytest.raises(NothingSurvivedError, match=r"of 1 object none can be tried \(1 [a-z-]+\): choose other scenes"):
        build_split(parked, "adv", replace(QUICK, out=tmp_path / "out"))


def test_an_earlier_adversary_that_is_disturbed_discards_the_next(
    source: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the new vehicle's own verdict says."""
    checked = []

    def never(scene: Any, agent: int, start: int, hyper: HyperParameters, limits: Any) -> VerificationFailure:
        checked.append(scene.agents.ids[agent])
        return VerificationFailure(DiscardReason.HITS_OBJECT)

    monkeypatch.setattr("generation.search.attempts.verify", never)
    with pytest.raises(NothingSurvivedError, match="too-few-adversaries"):
        build_split(source, "adv", replace(PAIRS, out=tmp_path / "out", scenes=("scene-9901",)))
    rows = rows_of(tmp_path / "out")
    assert {row["discard"] for row in rows if row["earlier"]} <= set(DiscardReason)
    assert set(checked) <= {row["earlier"][0] for row in rows if row["earlier"]}
