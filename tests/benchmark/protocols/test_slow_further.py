"""The further protocols against their slow versions, and what must hold between them."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import shapely
import torch
from hypothesis import given, settings

from benchmark.datasets.sample_truth import SampleRoads, SceneRoadSurfaces
from benchmark.protocols import PROTOCOLS, stp3
from benchmark.road_map import RoadMap, as_multipolygon
from tests.benchmark.protocols import slow_further_protocols as further
from tests.benchmark.protocols import slow_protocols as slow
from tests.benchmark.protocols.protocol_cases import Traits, plan_of, sample_of, traits

SLOW = {"stp3": further.slow_stp3, "bev-planner": further.slow_bev_planner, "omnidrive": further.slow_omnidrive}


@pytest.mark.parametrize("name", SLOW)
@settings(max_examples=15, deadline=None)
@given(kind=traits(coarse=False))
def test_verdicts_are_those_of_the_slow_version(name: str, kind: Traits) -> None:
    sample, plan = sample_of(kind), plan_of(kind)
    outcomes, expected = PROTOCOLS[name].evaluate([sample], plan[None]), SLOW[name](sample, plan)
    assert bool(outcomes.counted[0]) == expected.counted
    here = sample.ego_future_valid
    for column, flags in expected.steps.items():
        found = outcomes.collision if column == "collision" else outcomes.steps[column]
        assert found[0][here].tolist() == np.array(flags)[here].tolist(), column
    if here.all():
        values = PROTOCOLS[name].sample_values(outcomes)
        for column, wanted in expected.values.items():
            if not np.isnan(values[column]).any():
                assert values[column][0] == pytest.approx(wanted, abs=1e-9), column


@settings(max_examples=25, deadline=None)
@given(traits(coarse=True))
def test_mirrored_rasters(kind: Traits) -> None:
    sample, plan = sample_of(kind), plan_of(kind)
    here = sample.ego_future_valid
    for names, judge, rows in (
        (("opendrivevla",), slow.slow_uniad, False),
        (("opendrivevla-stp3", "agent-driver-stp3"), slow.slow_vad, True),
    ):
        expected = np.array(further.slow_mirrored(sample, plan, judge, rows=rows))
        for name in names:
            found = PROTOCOLS[name].evaluate([sample], plan[None]).step("before_mask")[0]
            assert found[here].tolist() == expected[here].tolist(), name


@settings(max_examples=25, deadline=None)
@given(traits(coarse=True))
def test_agent_driver_is_uniad_and_latched_flags_never_fall(kind: Traits) -> None:
    sample, plan = [sample_of(kind)], plan_of(kind)[None]
    uniad = PROTOCOLS["uniad"].evaluate(sample, plan)
    assert PROTOCOLS["agent-driver"].evaluate(sample, plan).as_rows() == uniad.as_rows()
    for name, flags in (
        ("safemvdrive", uniad.step("before_mask")),
        ("safemvdrive-box", PROTOCOLS["sparsedrive"].evaluate(sample, plan).step("before_mask")),
    ):
        found = PROTOCOLS[name].evaluate(sample, plan)
        latched = np.maximum.accumulate(flags[0]) if found.counted[0] else np.zeros(6, dtype=np.bool_)
        assert found.collision[0].tolist() == latched.tolist()
        values = PROTOCOLS[name].sample_values(found)["collision"][0]
        assert values.tolist() == sorted(values.tolist())


def test_safemvdrive_drops_samples_whose_recorded_ego_collides_at_once() -> None:
    kinds = [Traits(seed, 8, 9.0, 6, "drive", False) for seed in range(40)]
    truths, plans = [sample_of(kind) for kind in kinds], np.array([plan_of(kind) for kind in kinds])
    uniad = PROTOCOLS["uniad"].evaluate(truths, plans)
    found = PROTOCOLS["safemvdrive"].evaluate(truths, plans)
    assert found.counted.tolist() == (~uniad.step("recorded")[:, 0]).tolist()
    assert 0 < found.counted.sum() < 40 and not found.collision[~found.counted].any()
    box = PROTOCOLS["safemvdrive-box-all"].evaluate(truths, plans)
    assert 0 < box.counted.sum() < 40 and not box.collision[~box.counted].any()


def test_cell_centres_of_the_warp_are_those_of_pytorch() -> None:
    theta = torch.eye(2, 3)[None]
    grid = torch.nn.functional.affine_grid(theta, [1, 1, 200, 200], align_corners=False)
    assert grid[0, 0, :, 0].tolist() == stp3._CENTRES.tolist()


def test_the_kerb_is_said_of_samples_with_a_map_only() -> None:
    kinds = [Traits(seed, 0, 9.0, 6, "drive", False) for seed in (4, 5)]
    truths, plans = [sample_of(kind) for kind in kinds], np.array([plan_of(kind) for kind in kinds])
    assert [truth.roads is None for truth in truths] == [True, False]
    for name, column in (("bev-planner", "kerb"), ("omnidrive", "off_road")):
        values = PROTOCOLS[name].sample_values(PROTOCOLS[name].evaluate(truths, plans))
        assert np.isnan(values[column][0]).all() and not np.isnan(values[column][1]).any()
        assert not np.isnan(values["collision"]).any()


def test_leaving_the_road_is_seen_by_both() -> None:
    truths = [sample_of(Traits(seed, 0, 9.0, 6, "drive", False)) for seed in range(1, 4)]
    aside = np.cumsum(np.tile([4.0, 2.0], (3, 6, 1)), axis=1)
    for name, column in (("bev-planner", "kerb_before_mask"), ("omnidrive", "off_road")):
        assert PROTOCOLS[name].evaluate(truths, aside).steps[column].any(axis=1).all()


@pytest.mark.parametrize("name", ["bev-planner", "omnidrive"])
def test_no_raster_outlives_its_sample(name: str) -> None:
    """A raster is a megabyte: neither what is kept nor the peak may grow by one for each sample."""
    kinds = [Traits(4 * seed + 1, 4, 9.0, 6, "drive", False) for seed in range(40)]
    truths, plans = [sample_of(kind) for kind in kinds], np.array([plan_of(kind) for kind in kinds])
    assert all(truth.roads is not None for truth in truths)
    peaks = []
    for count in (10, 40):
        tracemalloc.start()
        outcomes = PROTOCOLS[name].evaluate(truths[:count], plans[:count])
        kept, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert len(outcomes) == count and kept < 3e6
        peaks.append(peak)
    assert peaks[1] - peaks[0] < 30 * 0.2e6


def test_a_map_without_roads_says_nothing_of_kerbs() -> None:
    sample = sample_of(Traits(5, 3, 9.0, 6, "drive", False))
    assert sample.roads is not None and sample.axle_poses is None
    area = RoadMap("made-up", as_multipolygon(shapely.box(-60.0, -60.0, 60.0, 60.0)))
    bare = replace(sample, roads=SampleRoads(SceneRoadSurfaces(area), np.zeros(3)))
    plan = plan_of(Traits(5, 3, 9.0, 6, "drive", False))[None]
    values = {name: PROTOCOLS[name].sample_values(PROTOCOLS[name].evaluate([bare], plan)) for name in SLOW}
    assert np.isnan(values["bev-planner"]["kerb"]).all() and not np.isnan(values["omnidrive"]["off_road"]).any()
    assert bare.roads is not None and bare.roads.kerb_lines().shape == (0, 20, 2)
