"""What is stored of a scene's judgement: checked at the edge, summed up, absent in old records."""

import shutil
from pathlib import Path

import pytest
from pydantic import ValidationError

from benchmark.machine.storage import read_json, write_json
from benchmark.records.attempts import Attempt
from benchmark.records.run import load_record
from benchmark.records.scene_assessment import DRIVER_NAMES, AssessmentSummary, SceneAssessment, is_unsolvable
from tests.benchmark.records.made_judgements import hits, made_judgement

GOLDEN = Path(__file__).parents[2] / "golden/records"


def drivers(**changed: dict[str, object]) -> dict[str, object]:
    return {**{name: {"survives": True} for name in DRIVER_NAMES}, **changed}


def test_a_judgement_is_the_same_after_it_was_stored() -> None:
    judged = made_judgement(drivers=drivers(constant=hits(), cc={"survives": True, "reacted_s": 1.0,
        "reacted_to": "adversary", "reacted_to_instance": "a"}))  # fmt: skip
    assert SceneAssessment.model_validate_json(judged.model_dump_json()) == judged


@pytest.mark.parametrize(
    "changes",
    [
        {"drivers": {"cc": {"survives": True}}}, {"drivers": drivers(cc={"survives": False})},
        {"drivers": drivers(cc={**hits(), "survives": True})},
        {"drivers": drivers(cc={"survives": True, "reacted_s": 1.0})}, {"chance": "until"}, {"margin_s": 1.0},
        {"faults": {}},
        {"faults": {"unknown": {"off_road": "no map"}, "beyond_limits": False, "off_road": False, "contact": False}},
        {"encounter": {"least_gap_m": -1.0}}, {"definition": 0}, {"unheard": 1},
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        made_judgement(**changes)


def test_a_summary_has_the_most_severe_of_several_adversaries() -> None:
    far = made_judgement()
    near = made_judgement(
        adversary="b",
        encounter={
            **{"least_gap_m": 0.5, "least_ttc_s": None, "tet_s": 0.3, "tit_s2": 0.1},
            **{"pet_s": 1.2, "pet_first": "ego", "max_btn": None},
        },
        faults={
            **{"off_road": True, "contact": False, "against_traffic": False, "hovering": False, "teleport": False},
            **{"beyond_limits": None, "unknown": {"beyond_limits": "no 12 Hz track"}},
        },
    )
    summary = AssessmentSummary.of([far, near])
    assert (summary.least_gap_m, summary.least_ttc_s, summary.tet_s, summary.pet_s) == (0.5, 3.0, 0.3, 1.2)
    assert (summary.max_btn, summary.faults, summary.unknown_faults) == (0.1, ["off_road"], ["beyond_limits"])
    assert summary.survives == dict.fromkeys(DRIVER_NAMES, True) and not summary.unsolvable


def test_of_several_adversaries_the_one_that_is_hit_decides() -> None:
    assert not is_unsolvable([])
    hopeless, harmless = made_judgement(unsolvable=True), made_judgement()
    assert is_unsolvable([hopeless]) and not is_unsolvable([hopeless, harmless])
    struck = made_judgement(unsolvable=True, drivers=drivers(constant=hits()))
    assert is_unsolvable([struck, harmless])
    passed = made_judgement(drivers=drivers(constant=hits()))
    assert not is_unsolvable([passed, hopeless])
    elsewhere = made_judgement(unsolvable=True, drivers=drivers(constant=hits("another_adversary")))
    assert not is_unsolvable([elsewhere, passed])


def test_attempts_of_older_versions_have_no_judgement() -> None:
    old = {
        **{"scene": "s", "agent": "a", "seed": 0, "kept": True, "discard": None, "launch_frame": 3},
        **{"challenge": 1.0, "closest_approach": None, "least_time_to_collision_s": None},
    }
    assert Attempt.model_validate(old).judgements == () and "judgements" not in Attempt.model_validate(old).as_json()
    new = Attempt.model_validate({**old, "judgements": [made_judgement().model_dump(mode="json")]})
    assert new.judgements == (made_judgement(),)


def test_records_of_schema_4_have_no_judgement(tmp_path: Path) -> None:
    directory = tmp_path / "schema-4"
    shutil.copytree(GOLDEN / "schema-3-adv", directory)
    run = read_json(directory / "run.json")
    write_json(directory / "run.json", {**run, "schema": 4})
    record = load_record(directory)
    assert {facts.judgement for facts in record.run.scene_facts.values()} == {None} and record.run.realism is None
