"""The judgement of scenes whose answer is known."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from benchmark.fairness.scene_assessment import AdversaryProvenance, SceneFaultAttribution, assess_scene
from benchmark.fairness.validity import NO_MAP, NO_TRACK
from benchmark.interactions.contacts import ContactKind
from benchmark.records.scene_assessment import (
    DRIVER_NAMES,
    TRACK_DEFECT_NAMES,
    AssessmentSummary,
    SceneAssessment,
    is_unsolvable,
)
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from tests.benchmark.fairness.made_scenes import LANE_Y, RIGHT_Y, driven, far_cut_in, hard_stop
from tests.hand_made import Car, scene_on_straight_road

GENERATED = AdversaryProvenance(generated=True)


def judged(scene: Scene, known: AdversaryProvenance = GENERATED) -> SceneAssessment:
    (found,) = assess_scene(scene, known)
    return found


def survivors(judgement: SceneAssessment) -> set[str]:
    return {name for name, run in judgement.drivers.items() if run.survives}


def test_nobody_survives_a_leader_5_m_ahead_that_brakes_at_9_m_s2_to_a_stand() -> None:
    found = judged(hard_stop())
    assert survivors(found) == set() and found.unsolvable and is_unsolvable([found])
    # A swerve at once would do, but nobody can react at once.
    assert found.chance == "until" and found.margin_s is not None and found.margin_s < 0.0
    assert found.first_visible_s == 0.0
    careful = found.drivers["cc"]
    assert careful.contact is not None and careful.contact.party == "adversary" == careful.reacted_to
    assert careful.contact.kind in ("front", "stopped_track") and careful.contact.instance == found.adversary
    assert found.encounter is not None and found.encounter.contact is not None
    impact = found.encounter.contact
    assert impact.at_fault and impact.kind == "front" and 0.0 < impact.fatal_probability < 1.0
    assert impact.delta_v_ego_m_s + impact.delta_v_other_m_s == pytest.approx(impact.impact_speed_m_s, abs=1e-5)
    assert found.encounter.pet_s == 0.0 and found.encounter.pet_first == "none" and found.encounter.least_gap_m == 0.0


@pytest.mark.parametrize("speed", [12.0, 25.0])
def test_everybody_survives_one_that_cuts_in_40_m_ahead_and_keeps_the_speed(speed: float) -> None:
    found = judged(far_cut_in(speed))
    assert survivors(found) == set(DRIVER_NAMES) and not found.unsolvable
    assert found.chance == "not_threatened" and found.margin_s is None
    assert found.encounter is not None and found.encounter.contact is None
    assert found.encounter.least_gap_m == pytest.approx(40.0, abs=0.2) and found.encounter.tet_s == 0.0
    # Rounding of positions leaves a hair of closing speed at the most.
    assert found.encounter.least_ttc_s is None or found.encounter.least_ttc_s > 1000.0


def test_what_is_judged_is_the_same_every_time_and_rounded() -> None:
    first, again = judged(hard_stop()), judged(hard_stop())
    assert first.model_dump_json() == again.model_dump_json()
    assert SceneAssessment.model_validate_json(first.model_dump_json()) == first
    # As a process sends it, and as a file has it.
    assert first.model_dump(mode="json", exclude_unset=True) == first.model_dump(mode="json")


def test_each_of_several_adversaries_has_a_judgement() -> None:
    scene = scene_on_straight_road((Car(40.0, LANE_Y, 8.0), Car(52.0, RIGHT_Y, 8.0)), ego_x=20.0, seconds=6.0)
    time = np.minimum(scene.seconds, 8.0 / 2.0)
    scene = driven(scene, 0, 40.0 + 8.0 * time - 1.0 * time**2, np.full(len(scene.seconds), LANE_Y))
    scene = driven(scene, 1, 52.0 + 8.0 * scene.seconds, np.full(len(scene.seconds), RIGHT_Y))
    first, second = assess_scene(scene, GENERATED)
    assert first.encounter is not None and second.encounter is not None and second.encounter.contact is None
    assert (first.adversary, second.adversary) == scene.adversaries
    hit = first.drivers["constant"].contact, second.drivers["constant"].contact
    assert hit[0] is not None and hit[1] is not None
    assert (hit[0].party, hit[1].party) == ("adversary", "another_adversary")
    assert survivors(first) == survivors(second) and first.last_chance_s == second.last_chance_s is not None
    summary = AssessmentSummary.of([first, second])
    assert not summary.unsolvable and not summary.survives["constant"] and summary.contact == first.encounter.contact


def test_without_an_adversary_only_the_drivers_are_judged() -> None:
    found = judged(scene_on_straight_road(seconds=4.0))
    assert (found.adversary, found.unsolvable, found.encounter, found.faults) == (None, None, None, None)
    assert found.first_visible_s is None and found.drivers["recorded"].survives
    assert AssessmentSummary.of([found]).unsolvable is None and not is_unsolvable([found])
    assert judged(replace(far_cut_in(), adversaries=("nobody",))).adversary is None
    assert assess_scene(far_cut_in().first_frames(1), GENERATED) == (), "one frame is no scene"


def test_limits_and_jumps_are_not_asked_of_what_a_reader_interpolates() -> None:
    scene = far_cut_in()
    generated, annotated = judged(scene), judged(scene, AdversaryProvenance(generated=False))
    assert generated.faults is not None and annotated.faults is not None
    assert (generated.tracks, generated.faults.unknown) == ("generated", {})
    # The made-up car turns its heading at once.
    assert generated.faults.found == ("beyond_limits",)
    assert annotated.faults.unknown == {"beyond_limits": NO_TRACK, "teleport": NO_TRACK}
    assert {name for name in TRACK_DEFECT_NAMES if getattr(annotated.faults, name) is False} == {
        "off_road", "contact", "against_traffic", "hovering",
    }  # fmt: skip


def test_only_the_adversarial_stretch_counts() -> None:
    scene = far_cut_in()
    late = AdversaryProvenance(generated=True, launches={scene.adversaries[0]: 72})
    found = judged(scene, late).faults
    assert found is not None and found.found == ()


def test_what_happens_before_the_adversary_acts_is_nobodys_verdict() -> None:
    """Who brakes for the leader ahead is run into by the car behind, until the leader has left the lane at 5 s."""
    leader, behind, beside = Car(36.0, LANE_Y, 10.0), Car(14.0, LANE_Y, 10.0), Car(60.0, RIGHT_Y, 10.0)
    scene = scene_on_straight_road((leader, behind, beside), ego_x=20.0, ego_speed=10.0, seconds=9.0)
    aside = LANE_Y + np.clip((scene.seconds - 3.0) * 1.75, 0.0, 3.5)
    scene = replace(driven(scene, 0, 36.0 + 10.0 * scene.seconds, aside), adversaries=(scene.agents.ids[2],))

    def launched(frame: int) -> SceneAssessment:
        return judged(scene, AdversaryProvenance(generated=True, launches={scene.adversaries[0]: frame}))

    early, late = launched(12), launched(72)
    assert (early.acts_s, late.acts_s) == (1.0, 6.0) and survivors(late) == set(DRIVER_NAMES)
    for name in ("fsm", "rss"):
        run = early.drivers[name]
        assert run.contact is not None and (run.contact.party, run.contact.kind) == ("other", "rear")
        assert run.reacted_s == 1.0 < run.contact.time_s < 6.0
    # Nobody reacts to an adversary that does nothing yet.
    assert (early.first_visible_s, late.first_visible_s) == (1.0, 6.0)
    unknown = judged(scene)
    assert unknown.acts_s is None and unknown.first_visible_s == 0.0 and survivors(unknown) == survivors(early)


def test_drivers_take_over_when_the_first_of_several_adversaries_acts() -> None:
    cars = (Car(80.0, RIGHT_Y, 8.0), Car(100.0, RIGHT_Y, 8.0))
    scene = scene_on_straight_road(cars, ego_x=20.0, seconds=4.0)
    first, second = scene.agents.ids
    scene = replace(scene, adversaries=(first, second))
    for launches, acts in (({first: 24, second: 12}, 1.0), ({first: 24}, None)):
        found = assess_scene(scene, AdversaryProvenance(generated=True, launches=launches))
        assert [each.acts_s for each in found] == [acts, acts]


def test_without_a_map_manoeuvres_may_go_anywhere_and_nobody_knows_who_left_the_road() -> None:
    empty = RoadMap("nowhere", shapely.MultiPolygon())
    found = judged(replace(hard_stop(12.0, 12.0), road_map=empty))
    assert not found.has_map and found.faults is not None
    assert found.faults.unknown == {"off_road": NO_MAP, "against_traffic": NO_MAP}


def test_a_lateral_contact_is_the_egos_fault_in_several_lanes_alone() -> None:
    scene = scene_on_straight_road(seconds=4.0)
    inside, between = np.array([60.0, LANE_Y, 4.084, 1.73, 0.0]), np.array([60.0, 196.5, 4.084, 1.73, 0.0])
    outside = np.array([60.0, 192.5, 4.084, 1.73, 0.0])
    blame = SceneFaultAttribution(scene)
    assert [blame.at_fault(ContactKind.LATERAL, box) for box in (inside, between, outside)] == [False, True, True]
    assert blame.at_fault(ContactKind.FRONT, inside) and not blame.at_fault(ContactKind.REAR, between)
    nowhere = SceneFaultAttribution(replace(scene, road_map=RoadMap("nowhere", shapely.MultiPolygon())))
    assert nowhere.at_fault(ContactKind.LATERAL, inside) is None and nowhere.at_fault(ContactKind.FRONT, inside)
