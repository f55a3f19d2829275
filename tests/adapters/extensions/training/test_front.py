"""Lines and things ahead: how the front camera and eyes of the plan's own learn them, what the plan makes of it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import shapely
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from adapters.extensions.training.dense_targets import (
    LANE_AHEAD_M,
    LANE_NUMBERS,
    OFFSET_UNIT_M,
    OFFSETS,
    lane_loss,
    lane_offsets,
    offset_loss,
    offsets_to_lines,
)
from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.front import (
    FARTHEST_GAP_M,
    FRONT_BACKBONE_PREFIX,
    GAP_UNIT_M,
    HEAT_CLASSES,
    RARE_WALKER,
    STRIPS_M,
    WEIGHTS,
    FrontObjective,
    add_front_backbone,
    front_losses,
    gap_ahead,
    object_heat_loss,
    transfer_sparse_front_backbone,
    walkers_ahead,
)
from adapters.extensions.training.image_encoder import centre_loss, front_heat, image_targets
from adapters.extensions.training.losses import lateral_loss
from adapters.extensions.training.sparse import phases as sparse_phases
from adapters.extensions.training.sparse.phases import network_inputs
from adapters.extensions.training.uniad.phases import transfer_from_vad
from adapters.extensions.training.vad import phases as vad_phases
from adapters.extensions.training.vad.objective import COARSE
from adapters.extensions.training.vad.phases import transfer_start_weights
from adapters.networks.layers.front_reader import FRONT, FrontReader
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseDrive, SparseInputs
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from benchmark.constants import DETECTION_CLASSES
from tests.adapters.extensions.training.road_frames import a_frame, empty
from tests.adapters.extensions.training.sparse import learner as sparse
from tests.adapters.extensions.training.sparse.learner import frame
from tests.adapters.networks.sparse.miniature import MINIATURE, filled
from tests.adapters.networks.vad.small_vad import SMALL, small_network

AHEAD = len(LANE_AHEAD_M)
STRIPS = len(STRIPS_M) - 1


def shifted(frame: TrainingFrame, to_the_right: float) -> TrainingFrame:
    return replace(frame, lines=frame.lines + torch.tensor([to_the_right, 0.0]))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_offsets_end_at_the_nearest_point_of_any_line(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    points = 20 * torch.rand(7, 2, generator=generator) - 10
    lines = 20 * torch.rand(3, 5, 2, generator=generator) - 10
    offsets = offsets_to_lines(points, lines)
    drawn = shapely.MultiLineString(lines.numpy().tolist())
    for point, offset in zip(points.numpy(), offsets.numpy(), strict=True):
        assert np.hypot(*offset) == pytest.approx(drawn.distance(shapely.Point(point)), abs=1e-4)
        assert drawn.distance(shapely.Point(point + offset)) < 1e-4


def test_lines_on_both_sides_are_known_where_they_are_near_and_half_a_metre_off_costs_half() -> None:
    frame = a_frame()
    offsets, known = lane_offsets(frame)
    assert len(offsets) == LANE_NUMBERS == 2 * AHEAD
    # The boundary on the left is six metres off.
    assert known.tolist() == [False] * AHEAD + [True] * AHEAD
    assert offsets[AHEAD:].tolist() == pytest.approx([0.5] * AHEAD)
    turned = replace(frame, lines=frame.lines + frame.lines[..., 1:] * torch.tensor([0.1, 0.0]))
    assert lane_offsets(turned)[0][AHEAD:].tolist() == pytest.approx([0.5 + 0.1 * ahead for ahead in LANE_AHEAD_M])
    nearer = shifted(frame, 2.0)
    offsets, known = lane_offsets(nearer)
    assert known.all() and offsets.tolist() == pytest.approx([-4.0] * AHEAD + [2.5] * AHEAD)
    assert lane_loss(offsets, nearer) == 0 and float(lane_loss(offsets + 0.5, nearer)) == pytest.approx(0.5)
    # Nobody drives along a crossing.
    crossing = replace(frame, line_labels=torch.tensor([2, 1, 2]))
    assert not lane_offsets(crossing)[1].any() and lane_loss(offsets, crossing) == lane_loss(offsets, empty(frame)) == 0


def test_cells_say_where_lines_are() -> None:
    frame, grid = a_frame(), SMALL.grid
    low, high = torch.tensor(grid.range_m[:2]), torch.tensor(grid.range_m[3:5])
    centres = low + grid.centres() * (high - low)
    right = torch.cat([offsets_to_lines(centres, frame.lines[frame.line_labels == kind]) for kind in (0, 2)], 1)
    right = right / OFFSET_UNIT_M
    assert right.shape == (grid.cells, OFFSETS)
    assert float(offset_loss(right, frame, grid)) == pytest.approx(0, abs=1e-6)
    assert float(offset_loss(right + 1.0, frame, grid)) == pytest.approx(1.0)
    assert float(offset_loss(right, empty(frame), grid)) == 0


def test_room_ahead_is_up_to_whoever_is_on_the_way() -> None:
    frame = a_frame()
    # The middle of a car 4.5 m long is 12 m ahead; the pedestrian is five metres to the left.
    assert gap_ahead(frame) == pytest.approx(12.0 - 2.25)
    assert gap_ahead(empty(frame)) is None
    boxes = frame.boxes.clone()
    boxes[0, 0] = 4.0
    assert gap_ahead(replace(frame, boxes=boxes)) == FARTHEST_GAP_M
    boxes[0, :2] = torch.tensor([0.0, -8.0])
    assert gap_ahead(replace(frame, boxes=boxes)) == FARTHEST_GAP_M
    standing = replace(frame, ego_future=torch.zeros(6, 2))
    assert gap_ahead(standing) == pytest.approx(12.0 - 2.25)
    # Round a quarter of a circle of 12 m the pedestrian's place is on the way.
    turn = torch.linspace(0.0, torch.pi / 2, 7)[1:]
    left = torch.stack([12 * turn.cos() - 12, 12 * turn.sin()], -1)
    boxes[1, :2] = torch.tensor([12 * 0.5**0.5 - 12, 12 * 0.5**0.5])
    found = gap_ahead(replace(frame, boxes=boxes, ego_future=left))
    assert found == pytest.approx(12 * torch.pi / 4 - 0.3, abs=0.3)


def test_what_is_said_of_the_way_ahead_counts_where_one_drives_straight_on() -> None:
    frame = shifted(a_frame(aside=1.0), 2.0)
    said = torch.cat(
        [
            lane_offsets(frame)[0],
            frame.ego_future[:, 0],
            torch.tensor([(gap_ahead(frame) or 0) / GAP_UNIT_M]),
            walkers_ahead(frame),
            torch.ones(3),
        ]
    )
    losses = front_losses(said, frame)
    assert set(losses) == set(WEIGHTS) and max(losses.values()) < 1e-6
    wrong = front_losses(said + 0.5, frame)
    assert float(wrong["ahead"]) == pytest.approx(0.125) and float(wrong["gap"]) == pytest.approx(0.5)
    somebody = int((walkers_ahead(frame) > 0).sum())
    assert somebody == 1 and float(wrong["walkers"]) == pytest.approx(0.25 * (STRIPS + RARE_WALKER * somebody))
    assert front_losses(said + 0.5, replace(frame, command=1))["ahead"] == 0
    silent = torch.cat([said[: -STRIPS - 3], torch.zeros(STRIPS + 3)])
    assert not any(front_losses(silent, empty(frame)).values())


def test_the_nearest_walker_of_each_strip_counts() -> None:
    places = torch.tensor([[-2.0, 10.0], [-2.5, 5.0], [0.0, 20.0], [0.5, -3.0], [4.0, 30.0], [7.0, 5.0], [2.0, 12.5]])
    walker = DETECTION_CLASSES.index("pedestrian")
    labels = torch.full((len(places),), walker)
    boxes = torch.cat([places, torch.zeros(len(places), 7)], 1)
    frame = replace(a_frame(), boxes=boxes, labels=labels)
    assert walkers_ahead(frame).tolist() == pytest.approx([0.0, 0.8, 0.2, 0.5, 0.0])
    assert not walkers_ahead(replace(frame, labels=labels * 0)).any() and not walkers_ahead(empty(frame)).any()


def test_a_way_to_the_side_asks_for_the_mean_and_not_for_the_median() -> None:
    wanted = torch.tensor([0.0, 0.0, 0.0, 0.8])
    counted = torch.ones(4, dtype=torch.bool)
    tried = torch.linspace(0, 0.8, 81)
    best = min(tried, key=lambda each: float(lateral_loss(each.expand(4), wanted, counted)))
    assert float(best) == pytest.approx(0.2, abs=0.011)
    assert lateral_loss(wanted + 1.0, wanted, ~counted) == 0


def vad_front() -> tuple[nn.Module, FrontObjective, list[TrainingFrame]]:
    network = small_network(config=replace(SMALL, backbone_outputs=(1, 2), pyramid_levels=2, plan_sees_front=18))
    reader = vad_phases.find_front_reader(network)
    assert reader is not None
    frames = [shifted(a_frame(number, scene), by) for number, (scene, by) in enumerate((("a", 1.0), ("b", 3.0)))]
    return network, FrontObjective(network, reader, vad_phases.build_front_encoder(network)), frames


def sparse_front(own_eyes: bool = True) -> tuple[nn.Module, FrontObjective, list[TrainingFrame]]:
    network = sparse.network("sparsedrive", replace(sparse.TINY, plan_sees_front=18, front_eyes=own_eyes))
    reader = sparse_phases.find_front_reader(network)
    assert reader is not None
    objective = FrontObjective(network, reader, sparse_phases.build_front_encoder(network))
    return network, objective, [sparse.frame(index) for index in range(3)]


@pytest.mark.parametrize("steps", [30, pytest.param(80, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("build", "loss", "rate", "learns"),
    [
        (
            vad_front,
            "lane",
            1e-2,
            ("img_neck.lateral_convs.0.", "img_neck.fpn_convs.0.", "pts_bbox_head.front_reader."),
        ),
        (sparse_front, "things", 3e-3, (FRONT_BACKBONE_PREFIX, "head.motion_plan_head.front_reader.")),
    ],
    ids=["vad", "own eyes"],
)
def test_the_front_camera_learns_what_it_is_asked_and_nothing_else_changes(
    build: Callable[[], tuple[nn.Module, FrontObjective, list[TrainingFrame]]],
    loss: str,
    rate: float,
    learns: tuple[str, ...],
    steps: int,
) -> None:
    network, objective, frames = build()
    before = {name: value.clone() for name, value in network.state_dict().items()}
    optimiser = torch.optim.Adam([each for each in network.parameters() if each.requires_grad], lr=rate)
    losses = []
    for _ in range(steps):
        optimiser.zero_grad()
        found = objective.losses(frames)
        torch.stack(list(found.values())).sum().backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        losses.append(float(found[loss].detach()))
    assert losses[-1] < losses[0] / (3 if steps > 30 else 1)
    changed = {name for name, value in network.state_dict().items() if not torch.equal(value, before[name])}
    assert all(any(name.startswith(part) for name in changed) for part in learns)
    assert all(name.startswith(learns) for name in changed)
    assert not any(name.startswith((f"img_neck.{COARSE}", "pts_bbox_head.front_reader.tell.")) for name in changed)


def test_a_plan_that_compares_is_told_what_changed_and_nothing_at_the_start() -> None:
    reader = FrontReader(4, 3, 8, compares=True)
    change = reader.tell_change
    assert change is not None and FrontReader(4, 3, 8).tell_change is None
    now, before = torch.randn(2, 3), torch.randn(2, 3)
    assert torch.equal(reader.told(now, None), reader.tell(now)) and torch.equal(
        reader.told(now, now), reader.tell(now)
    )
    assert torch.allclose(reader.told(now, before) - reader.tell(now), change(now - before), atol=1e-6)
    reader.zero_message()
    assert not reader.told(now, before).any()


def test_what_is_left_of_numbers_follows_them_and_forgets() -> None:
    gap = torch.arange(12, 0, -1, dtype=torch.float32)[:, None, None]
    left = None
    for numbers in gap:
        before, left = left, FrontReader.left(numbers, left)
    assert before is not None
    # Whatever falls by one in each key frame is two less than what is left of the frames before it.
    assert float(gap[-1] - before) == pytest.approx(-2.0, abs=0.01)
    assert torch.equal(FrontReader.left(gap[0], None), gap[0])


def vad() -> VAD:
    return VAD(VADConfig.miniature())


def reader_of(network: nn.Module) -> FrontReader:
    (found,) = [module for module in network.modules() if isinstance(module, FrontReader)]
    return found


def without_eyes(network: nn.Module) -> dict[str, Tensor]:
    state = network.state_dict()
    return {name: value for name, value in state.items() if not name.startswith(FRONT_BACKBONE_PREFIX)}


def test_own_eyes_begin_as_the_layers_that_made_the_maps_of_all_cameras() -> None:
    torch.manual_seed(3)
    trunk = SparseDrive(replace(SparseConfig.miniature(), front_eyes=False)).state_dict()
    begun = add_front_backbone(trunk)
    built = SparseDrive(SparseConfig.miniature())
    built.load_state_dict({name: begun[name] for name in built.state_dict()})
    assert built.front_eyes is not None and all(torch.equal(begun[name], value) for name, value in trunk.items())
    images = torch.randn(2, 3, 128, 224)
    with torch.inference_mode():
        fine, coarse = built.img_backbone(images)[:2]
        for own, other in zip(built.front_eyes.backbone(images), (fine, coarse), strict=True):
            torch.testing.assert_close(own, other)
        # Nothing is anywhere, and the rest is what the pyramid makes of the two finer stages.
        built.img_neck.get_parameter("lateral_convs.2.conv.bias").zero_()
        maps, said = built.img_neck([fine, coarse, torch.zeros(2, 512, 4, 7)])[0], built.front_eyes(images)
    assert (said[:, : len(HEAT_CLASSES)] == said[0, 0, 0, 0]).all() and said[0, 0, 0, 0].sigmoid() < 0.02
    torch.testing.assert_close(said[:, len(HEAT_CLASSES) :], maps[:, len(HEAT_CLASSES) :])
    # What has eyes already keeps them.
    bias = f"{FRONT_BACKBONE_PREFIX}fine.bias"
    again = add_front_backbone(begun | {bias: torch.ones_like(begun[bias])})
    assert again.keys() == begun.keys() and bool((again[bias] == 1).all())


def test_plans_look_at_the_front_camera_with_own_eyes_and_at_no_other() -> None:
    built = filled("sparsedrive", replace(MINIATURE, plan_sees_front=18, front_eyes=True))
    given = network_inputs(frame(0))
    assert built.front_eyes is not None

    def front(inputs: SparseInputs) -> Tensor:
        built.reset()
        taken = built.predict(inputs).planner.front
        assert taken is not None
        return taken

    with torch.inference_mode():
        wanted = reader_of(built)(built.front_eyes(given.images[FRONT : FRONT + 1]))
        torch.testing.assert_close(front(given), wanted)
        others = given.images.clone()
        others[FRONT + 1 :] += 1.0
        torch.testing.assert_close(front(replace(given, images=others)), wanted)
        for parameter in built.front_eyes.parameters():
            parameter.zero_()
        assert not torch.allclose(front(given), wanted)


def test_things_are_walkers_and_vehicles_and_cost_least_where_they_are() -> None:
    frames = [frame(0), frame(2)]
    assert np.array_equal(front_heat(frames[0]), image_targets(frames[0]).heat[FRONT])
    heats = torch.from_numpy(np.stack([front_heat(each) for each in frames]))
    wanted = torch.stack([heats[:, list(kinds)].amax(1) for kinds in HEAT_CLASSES], 1)
    assert (wanted == 1).any()
    maps = torch.randn(2, 5, *wanted.shape[-2:])
    torch.testing.assert_close(object_heat_loss(maps, frames), centre_loss(maps[:, :2], wanted))
    right, wrong = (torch.cat([sign * (16 * (wanted == 1) - 8.0), maps[:, 2:]], 1) for sign in (1, -1))
    assert float(object_heat_loss(right, frames)) < 0.1 < float(object_heat_loss(wrong, frames))


def test_what_a_sparse_miniature_reads_in_the_front_camera_vad_reads() -> None:
    torch.manual_seed(5)
    sparse, network = SparseDrive(SparseConfig.miniature()), vad()
    before = {name: value.clone() for name, value in network.state_dict().items()}
    taken = transfer_start_weights(sparse.state_dict())
    assert all(before[name].shape == value.shape for name, value in taken.items())
    network.load_state_dict(taken, strict=False)
    changed = {name for name, value in network.state_dict().items() if not torch.equal(value, before[name])}
    # Images, boxes and what the plan makes of the numbers stay its own.
    assert changed and all(name.startswith(FRONT_BACKBONE_PREFIX) or ".front_reader." in name for name in changed)
    assert not any(".front_reader.tell" in name for name in changed)
    images = torch.randn(6, 3, 128, 224)
    with torch.inference_mode():
        there, here = (
            each.finest_front(each.img_neck(each.img_backbone(images))[0], images) for each in (sparse, network)
        )
        torch.testing.assert_close(here, there)
        torch.testing.assert_close(reader_of(network)(here), reader_of(sparse)(there))


def test_of_weights_each_network_takes_what_it_can_use() -> None:
    weights, without = vad().state_dict(), without_eyes(vad())
    taken, begun = transfer_start_weights(weights), transfer_start_weights(without)
    assert taken.keys() == weights.keys() and all(torch.equal(taken[name], weights[name]) for name in taken)
    assert begun.keys() >= weights.keys()
    assert torch.equal(begun[f"{FRONT_BACKBONE_PREFIX}backbone.conv1.weight"], without["img_backbone.conv1.weight"])
    # UniAD reads another map with its front camera.
    given = transfer_from_vad(weights)
    assert "img_backbone.conv1.weight" in given
    assert not any(name.startswith(FRONT_BACKBONE_PREFIX) or "front_reader" in name for name in given)
    for none in (without_eyes(SparseDrive(SparseConfig.miniature())), weights):
        assert transfer_sparse_front_backbone(none, "reader.") == {}
