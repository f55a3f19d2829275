"""Figures of plans, and what a planner is shown for them."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.extensions.training.plan_figures import (
    ImageAblation,
    ImageCondition,
    evaluate_plans,
    observe_with_images,
    plan_figures,
)
from adapters.models import Model, miniatures
from adapters.planners.constant_velocity import ConstantVelocity
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

SCENES = ("scene-9901", "scene-9902")


def facts_of(small: Model) -> dict[str, Any]:
    """What is measured of a packaged miniature."""
    facts = json.loads(small.packaged.with_suffix(".json").read_text())
    assert isinstance(facts, dict)
    return facts


class Late:
    """Stops where it is; remembers how often it was asked and reset."""

    name = "late"

    def __init__(self) -> None:
        self.asked, self.resets = 0, 0

    def reset(self, scene: SceneInfo) -> None:
        self.resets += 1

    def plan(self, observation: Observation) -> Plan:
        self.asked += 1
        return Plan(np.zeros((6, 2)), PlanFrame.LIDAR)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene(name, seconds=5.0, ego_x=50.0 + 7 * k) for k, name in enumerate(SCENES)])
    return NuScenesData.open(root)


def test_distances_are_those_of_the_recording(data: NuScenesData) -> None:
    figures = plan_figures(ConstantVelocity(), data, SCENES)
    # The ego keeps its 8 m/s.
    assert figures.samples == 2 * 4 and figures.l2_3s_m < 0.01
    standing = plan_figures(Late(), data, SCENES)
    assert (standing.l2_1s_m, standing.l2_2s_m, standing.l2_3s_m) == pytest.approx((8.0, 16.0, 24.0), abs=0.01)


def test_a_planner_sees_all_samples_where_some_are_judged(data: NuScenesData) -> None:
    planner = Late()
    figures = plan_figures(planner, data, SCENES, every=2)
    assert figures.samples == 2 * 2 and planner.asked == 2 * 10 and planner.resets == 2


def test_what_is_lost_is_the_difference_of_the_figures_and_travels_through_a_file(data: NuScenesData) -> None:
    own, other = (evaluate_plans(planner, data, SCENES) for planner in (ConstantVelocity(), Late()))
    lost, (before, after) = ImageAblation.between(own, other), (own.figures(), other.figures())
    assert lost.l2_3s_m.value == pytest.approx(after.l2_3s_m - before.l2_3s_m, abs=1e-3)
    assert lost.collisions_pt.value == pytest.approx(100 * (after.collisions - before.collisions), abs=1e-3)
    assert lost.l2_3s_m.low is not None and lost.l2_3s_m.high is not None
    assert 0 < lost.l2_3s_m.low <= lost.l2_3s_m.value <= lost.l2_3s_m.high
    assert ImageAblation.from_log(json.loads(json.dumps(asdict(lost)))) == lost
    assert (
        ImageAblation.between(own, own).said()
        == "L2 at 3 s +0.00 [+0.00, +0.00] m, collisions +0.0 [+0.0, +0.0] points"
    )
    alone = [evaluate_plans(planner, data, SCENES[:1]) for planner in (ConstantVelocity(), Late())]
    assert ImageAblation.between(*alone).l2_3s_m.said(0) == "+24 [-, -]"


def test_images_are_changed_and_nothing_else(data: NuScenesData) -> None:
    own = list(data.observations(SCENES[0]))
    other = list(data.observations(SCENES[1]))
    for kind in ImageCondition:
        seen = list(observe_with_images(data, SCENES, 0, kind))
        for index, (observation, mine) in enumerate(zip(seen, own, strict=True)):
            assert observation.ego.velocity.tolist() == mine.ego.velocity.tolist()
            assert observation.command == mine.command
            for name, view in observation.views.items():
                pixels, camera = view.load(), mine.views[name].camera
                assert pixels.shape == (camera.height, camera.width, 3) and pixels.dtype == np.uint8
                assert (view.global_T_ego == mine.views[name].global_T_ego).all()
                if kind is ImageCondition.BLANK:
                    assert (pixels == pixels[0, 0, 0]).all()
                else:
                    source = mine if kind is ImageCondition.OWN else other[index]
                    assert (pixels == source.views[name].load()).all()


def test_what_cannot_be_measured_is_a_sentence(data: NuScenesData, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be shuffled"):
        plan_figures(Late(), data, SCENES[:1], images=ImageCondition.SHUFFLED)
    write_root(tmp_path, [short_scene("scene-9903", seconds=2.0)])
    with pytest.raises(InputError, match="none of the 1 scene has a sample"):
        plan_figures(Late(), NuScenesData.open(tmp_path), ["scene-9903"])


@pytest.mark.parametrize("name", [name for name, small in miniatures().items() if "lost" in facts_of(small)])
def test_the_packaged_miniatures_need_their_images(name: str) -> None:
    """As measured for their cards: without its own images each is farther from where it was driven, beyond chance."""
    lost = facts_of(miniatures()[name])["lost"]
    assert set(lost) == {"blank", "shuffled"}
    for each in lost.values():
        further = ImageAblation.from_log(each).l2_3s_m
        assert further.low is not None and further.low > 0
