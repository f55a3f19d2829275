"""Judgements of scenes that nobody has to compute."""

from typing import Any

from benchmark.records.scene_assessment import DRIVER_NAMES, TRACK_DEFECT_NAMES, SceneAssessment


def made_judgement(**changes: Any) -> SceneAssessment:
    """A harmless encounter that every driver survives, with some fields changed."""
    said: dict[str, Any] = {
        **{"adversary": "a", "category": "vehicle.car", "tracks": "generated", "has_map": True},
        "drivers": {name: {"survives": True} for name in DRIVER_NAMES},
        **{"first_visible_s": 0.0, "chance": "not_threatened", "last_chance_s": None, "margin_s": None},
        "unsolvable": False,
        "encounter": {
            **{"least_gap_m": 2.0, "least_ttc_s": 3.0, "tet_s": 0.0, "tit_s2": 0.0},
            **{"pet_s": None, "pet_first": None, "max_btn": 0.1},
        },
        "faults": dict.fromkeys(TRACK_DEFECT_NAMES, False),
    }
    return SceneAssessment.model_validate({**said, **changes})


def hits(party: str = "adversary") -> dict[str, Any]:
    """A run that ends in a contact."""
    contact = {
        **{"time_s": 3.0, "party": party, "instance": "a", "category": "vehicle.car", "kind": "front"},
        **{"ego_speed_m_s": 8.0, "other_speed_m_s": 2.0, "impact_speed_m_s": 6.0},
    }
    return {"survives": False, "contact": contact}
