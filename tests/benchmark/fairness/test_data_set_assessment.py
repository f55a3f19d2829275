"""Judgements of a data set's scenes: stored ones, those made when asked, and who the adversary is."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scene_assessments import (
    ASSESSMENTS_FILE,
    collect_assessments,
    collect_realism,
    format_assessments,
    read_assessments,
)
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.fairness.assessment_tables import build_split_tables, format_assessment
from benchmark.fairness.data_set_assessment import (
    CACHE_FOLDER,
    assess_data_set,
    collect_scene_facts,
    find_generated_agents,
    read_launches,
)
from benchmark.fairness.split_assessment import (
    OWN_TOWN_REASON,
    build_validity_rows,
    find_adversarial_names,
    judge_split,
    measure_split_realism,
    summarise_reference_drivers,
)
from benchmark.machine.workers import LocalProcesses
from benchmark.records.scene_assessment import DRIVER_NAMES
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from tests.benchmark.fairness.made_scenes import far_cut_in, hard_stop
from tests.benchmark.planners import Straight
from tests.benchmark.records.made_judgements import hits, made_judgement
from tests.executors import Forbidden
from tests.hand_made import Car, scene_on_straight_road

HERE = LocalProcesses(1)
SCENES = ("scene-0001-aa", "scene-0002-bb")


def bare(scene: Scene, name: str, vehicle: str = "n008") -> Scene:
    return replace(scene, name=name, cameras=(), vehicle=vehicle, log=f"{vehicle}-{name}")


def recorded_scenes(vehicle: str) -> list[Scene]:
    """The same cars at constant speed, with others around."""
    others = tuple(Car(60.0 + 40.0 * lane, 201.75, 9.0 + lane, np.pi) for lane in range(3))
    made = []
    for number, (scene, x) in enumerate(((far_cut_in(12.0), 65.73), (hard_stop(12.0, 12.0), 37.73)), start=1):
        same = scene_on_straight_road(
            (Car(x, float(scene.agents.position[0, 0, 1]), 12.0), *others),
            ego_x=20.0, ego_speed=12.0, seconds=8.0, name=f"scene-{number:04d}",
        )  # fmt: skip
        made.append(bare(same, f"scene-{number:04d}", vehicle))
    return made


def written(root: Path, scenes: list[Scene], *, made_from: bool) -> DataSet:
    plan = DataSetPlan(root=root, split="adv" if made_from else "val", version="v1.0-mini")
    report = {"agent": "a", "launch_frame": 6, "kept": True} if made_from else {}
    keys = [write_scene(plan, each, name=each.name, source_scene=each.name[:10], report=report) for each in scenes]
    finish_data_set(plan, keys)
    return open_data(root)


def adversarial_scenes(vehicle: str) -> list[Scene]:
    found = []
    for base, name, made in zip(recorded_scenes(vehicle), SCENES, (far_cut_in(12.0), hard_stop(12.0, 12.0))):
        track = np.column_stack([made.agents.position[0, :, :2], made.agents.yaw[0]])
        found.append(replace(base.with_adversary(0, slice(0, len(track)), track), name=name))
    return found


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return written(tmp_path_factory.mktemp("recorded") / "val", recorded_scenes("n008"), made_from=False)


@pytest.fixture(scope="module")
def adversarial(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return written(tmp_path_factory.mktemp("generated") / "adv", adversarial_scenes("n008"), made_from=True)


def test_scenes_that_nobody_judged_are_judged_when_asked_by_any_number_of_workers(adversarial: DataSet) -> None:
    found = assess_data_set(adversarial, SCENES, HERE)
    assert list(found) == list(SCENES) and found == assess_data_set(adversarial, SCENES, LocalProcesses(2))
    gentle, hard = (said[0] for said in found.values())
    assert gentle.tracks == "annotated" and gentle.adversary == adversarial.scene(SCENES[0]).adversaries[0]
    assert all(gentle.drivers[name].survives for name in DRIVER_NAMES)
    assert not hard.drivers["constant"].survives and hard.encounter is not None and hard.encounter.contact is not None


def test_stored_judgements_are_taken_and_change_no_fingerprint(adversarial: DataSet, tmp_path: Path) -> None:
    data = written(tmp_path / "adv", adversarial_scenes("n008"), made_from=True)
    assert data.scene_facts(SCENES)[SCENES[0]].judgement is None
    path = data.root / data.version / ASSESSMENTS_FILE
    stored = made_judgement(adversary="stored")
    path.write_text(format_assessments({SCENES[0]: (stored,)}))
    again = open_data(data.root)
    assert again.fingerprint() == data.fingerprint()
    assert collect_assessments(data.root, data.version) == {SCENES[0]: (stored,)}
    found = assess_data_set(again, SCENES, HERE)
    assert found == {SCENES[0]: (stored,), **assess_data_set(adversarial, SCENES[1:], HERE)}
    assert collect_realism(again.root, again.version) is None
    told = measure_split_realism(adversarial, found)
    path.write_text(format_assessments({SCENES[0]: (stored,)}, told))
    assert collect_realism(again.root, again.version) == told
    facts = again.scene_facts(SCENES)
    assert facts[SCENES[1]].judgement is None
    judgement = facts[SCENES[0]].judgement
    assert judgement is not None and judgement.least_gap_m == 2.0


def test_judgements_by_other_definitions_are_none_and_damage_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / ASSESSMENTS_FILE
    assert read_assessments(tmp_path) == {}
    path.write_text(format_assessments({"scene": (made_judgement(definition=1),), "bare": ()}))
    assert read_assessments(tmp_path) == {}
    for text in ('{"schema": 2, "scenes": {}}', '{"schema": 1, "scenes": {"a": [{}]}}', "[]", "{"):
        path.write_text(text)
        with pytest.raises(InputError, match=ASSESSMENTS_FILE):
            read_assessments(tmp_path)


def test_variants_of_recordings_have_judgements_of_their_own(tmp_path: Path) -> None:
    for number in range(2):
        folder = tmp_path / f"v{number}" / "v1.0-mini"
        folder.mkdir(parents=True)
        (folder / "scene.json").write_text("[]")
        judged = made_judgement(adversary=str(number))
        (folder / ASSESSMENTS_FILE).write_text(format_assessments({"scene-0001": (judged,)}))
    found = collect_assessments(tmp_path, "v1.0-mini")
    assert {name: said[0].adversary for name, said in found.items()} == {"v0/scene-0001": "0", "v1/scene-0001": "1"}


def test_who_does_not_do_what_anybody_did_was_generated(recordings: DataSet, tmp_path: Path) -> None:
    scene, base = adversarial_scenes("n008")[0], recordings.scene("scene-0001")
    assert find_generated_agents(scene, base) == (0,) and find_generated_agents(base, base) == ()
    unnamed = [replace(each, adversaries=()) for each in adversarial_scenes("n008")]
    data = written(tmp_path / "published", unnamed, made_from=True)
    (data.root / data.version / "challenger.json").unlink()
    stranger = open_data(data.root)
    assert find_adversarial_names(stranger, SCENES) == SCENES
    alone, compared = (assess_data_set(stranger, SCENES, HERE, base) for base in (None, recordings))
    assert [said[0].adversary for said in alone.values()] == [None, None]
    assert [said[0].adversary for said in compared.values()] == [stranger.scene(name).agents.ids[0] for name in SCENES]


def test_the_launch_is_what_the_data_set_says(adversarial: DataSet) -> None:
    scene = adversarial.scene(SCENES[0])
    assert read_launches(adversarial, scene) == {scene.adversaries[0]: 6}
    assert read_launches(adversarial, replace(scene, name="unknown")) == {}


def test_of_several_adversaries_the_earliest_launch_is_known(tmp_path: Path) -> None:
    data = written(tmp_path / "adv", adversarial_scenes("n008"), made_from=True)
    path = data.root / data.version / "challenger.json"
    provenance = json.loads(path.read_text())
    scene = replace(data.scene(SCENES[0]), adversaries=("a", "b"))
    cases: tuple[tuple[list[int | None], int | None], ...] = (
        ([12, 6], 6), ([12], None), ([12, None], None), ([12, 10_000], None),
    )  # fmt: skip
    for told, found in cases:
        provenance["scenes"][SCENES[0]]["report"] = {"adversaries": [{"launch_frame": each} for each in told]}
        path.write_text(json.dumps(provenance))
        assert read_launches(open_data(data.root), scene) == ({} if found is None else {"a": found, "b": found})


def test_drivers_of_a_data_set_take_over_at_the_launch_that_it_names(adversarial: DataSet) -> None:
    found = assess_data_set(adversarial, SCENES[:1], HERE)[SCENES[0]]
    assert [each.acts_s for each in found] == [0.5]
    assert "first frame" not in format_assessment(judge_split(adversarial, SCENES[:1], HERE))


def test_the_ladder_counts_whom_drivers_hit() -> None:
    drivers = {name: {"survives": True} for name in DRIVER_NAMES}
    behind = hits("other")
    behind["contact"]["kind"] = "rear"
    scenes = [
        (made_judgement(drivers={**drivers, "constant": hits(), "rss": {**behind, "beyond_end": True}}),),
        (made_judgement(),),
    ]
    rows = {row.driver: row for row in summarise_reference_drivers(scenes)}
    assert (rows["constant"].survives, rows["constant"].hit_adversary, rows["constant"].hit_from_behind) == (1, 1, 0)
    assert (rows["rss"].survives, rows["rss"].hit_adversary, rows["rss"].hit_from_behind) == (1, 0, 1)
    assert rows["rss"].beyond_end == 1 and rows["rss"].share == 0.5 and rows["cc"].share == 1.0


def test_rates_count_those_who_could_be_asked() -> None:
    faults = dict.fromkeys(("off_road", "contact", "against_traffic", "hovering"), False)
    unknown = {"beyond_limits": "no track", "teleport": "no track"}
    rows = {row.fault: row for row in build_validity_rows([
        made_judgement(), made_judgement(faults={**faults, "hovering": True, "unknown": unknown})
    ])}  # fmt: skip
    assert (rows["hovering"].count, rows["hovering"].of) == (1, 2)
    assert (rows["teleport"].count, rows["teleport"].of, rows["teleport"].unknown) == (0, 1, ("no track",))


def test_a_split_is_compared_with_its_recordings_feature_by_feature(adversarial: DataSet, recordings: DataSet) -> None:
    judged = judge_split(adversarial, SCENES, HERE, recordings)
    assert judged.unsolvable == () or set(judged.unsolvable) <= set(SCENES)
    ordinary = {row.driver: row for row in judged.ladder_of_recordings}
    assert (ordinary["constant"].survives, ordinary["constant"].of) == (2, 2) and judged.ladder[1].survives == 1
    realism = judged.realism
    assert realism.adversaries == 2 and realism.reference == f"the recordings {recordings.name}"
    assert [row.name for row in realism.features][-1] == "road_edge" and len(realism.features) == 9
    assert realism.headline is not None and realism.headline.realism == min(row.realism for row in realism.features)
    assert realism.ctg is not None and (realism.ctg.version, realism.ctg.mask) == ("ctg", "current_speed")
    text = format_assessment(judged)
    words = ("Realism, worst feature", "of the recordings", "ctg-realism@code, version ctg", "halves")
    assert all(name in text for name in (*SCENES, *words))
    itself = measure_split_realism(adversarial, judged.scenes, None)
    assert itself.reference == "the unchanged agents of the same scenes" and itself.ctg is None
    severity = {row.name: row for row in judged.severity}
    assert judged.contacts == 1 and severity["least gap, m"].of == 2 and severity["TET, s"].of == 1


def test_in_our_own_town_only_rates_are_given_and_why(tmp_path: Path) -> None:
    data = written(tmp_path / "adv", adversarial_scenes("n000"), made_from=True)
    judged = judge_split(data, SCENES, HERE)
    assert judged.realism.not_compared == OWN_TOWN_REASON and judged.realism.features == ()
    assert len(judged.realism.validity) == 6 and OWN_TOWN_REASON in format_assessment(judged)
    assert json.loads(judged.model_dump_json())["realism"]["worst"] is None


def test_recordings_have_nobody_to_compare(recordings: DataSet) -> None:
    assert find_adversarial_names(recordings, recordings.scene_names(None)) == ()
    judged = judge_split(recordings, recordings.scene_names(None), HERE)
    assert judged.realism.adversaries == 0 and judged.realism.not_compared is not None
    assert len(build_split_tables(judged)) == 2


def test_scenes_are_judged_once_for_all_planners(adversarial: DataSet, tmp_path: Path) -> None:
    first = collect_scene_facts(adversarial, SCENES, tmp_path, LocalProcesses(1))
    assert all(facts.judgement is not None for facts in first.values())
    assert first == collect_scene_facts(adversarial, SCENES, tmp_path, Forbidden())
    part = collect_scene_facts(adversarial, SCENES[:1], tmp_path / "elsewhere", LocalProcesses(1))
    assert part[SCENES[0]] == first[SCENES[0]]
    whole = collect_scene_facts(adversarial, SCENES, tmp_path / "elsewhere", LocalProcesses(1))
    assert whole == first


def test_recordings_are_not_judged(recordings: DataSet, tmp_path: Path) -> None:
    facts = collect_scene_facts(recordings, recordings.scene_names("val"), tmp_path, Forbidden())
    assert all(each.judgement is None for each in facts.values()) and not (tmp_path / CACHE_FOLDER).exists()


def test_records_have_them_and_damage_is_one_sentence(adversarial: DataSet, tmp_path: Path) -> None:
    record = evaluate(adversarial, "adv", Straight(), tmp_path, EvalSettings(protocols=("exact",)))
    said = [record.run.scene_facts[name].judgement for name in SCENES]
    assert all(each is not None for each in said)
    (kept,) = tmp_path.rglob(ASSESSMENTS_FILE)
    kept.write_text("{")
    with pytest.raises(InputError, match=ASSESSMENTS_FILE):
        evaluate(adversarial, "adv", Straight(), tmp_path, EvalSettings(protocols=("exact",)))
