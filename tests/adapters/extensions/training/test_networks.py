"""What the training of every network has in common: inputs, what teaches nothing, plans alone, learning by heart."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import islice
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from adapters.camera_inputs import RGB_MEAN_STD
from adapters.extensions.training.dataset_mixture import FrameStore
from adapters.extensions.training.frames import CachedFrames, TrainingFrame
from adapters.extensions.training.front import FRONT_BACKBONE_PREFIX
from adapters.extensions.training.sparse import phases as sparse_phases
from adapters.extensions.training.uniad import losses as uniad_losses
from adapters.extensions.training.uniad.objective import UniADObjective
from adapters.extensions.training.uniad.objective import plan_losses as uniad_plan_losses
from adapters.extensions.training.uniad.phases import UniADPlannerObjective
from adapters.extensions.training.vad import objective as vad_objective
from adapters.extensions.training.vad.phases import PERCEPTION, VADPlannerObjective, set_first_values
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseDrive
from adapters.networks.sparse.planner import SparsePlanner
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD
from adapters.networks.uniad.planner import UniADPlanner
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from adapters.networks.vad.planner import VADPlanner
from benchmark.datasets.nuscenes import NuScenesData
from tests.adapters.extensions.training import road_frames
from tests.adapters.extensions.training.road_frames import OneScene, empty
from tests.adapters.extensions.training.sparse import learner as sparse
from tests.adapters.extensions.training.uniad import learner as uniad
from tests.adapters.networks.vad.small_vad import SMALL as SMALL_VAD
from tests.adapters.networks.vad.small_vad import small_network as small_vad

Losses = dict[str, Tensor]


@dataclass(frozen=True)
class Learner:
    """A small network with what it learns by.

    Attributes:
        planner: Objective of the plan alone, which remembers what the rest of the network made of a scene.
        plan: Plan of a key frame, in metres.
        stays: Whether a parameter is none that the plan alone learns.
        told: What learns of the front camera's reader with the plan alone, if not all of it.
        forgets: A loss that tells whether something remembered was forgotten.
    """

    network: Callable[[], Any]
    objective: Callable[[Any], Any]
    planner: Callable[[Any], Any]
    frame: Callable[[int], TrainingFrame]
    inputs: Callable[[TrainingFrame], Any]
    plan: Callable[[Any, Any], Tensor]
    stays: Callable[[str], bool]
    told: frozenset[str] | None = None
    forgets: str = "plan"


def told_vad() -> VAD:
    """A network whose plan is told all that there is to be told."""
    config = replace(SMALL_VAD, plan_sees_front=18, plan_compares_front=True, front_eyes=True, plan_knows_motion=True)
    network = small_vad(config=config)
    head = network.pts_bbox_head
    assert head.motion_teller is not None and head.front_reader is not None
    assert head.front_reader.tell_change is not None
    for layer in (head.motion_teller.tell, head.front_reader.tell_change):
        nn.init.normal_(layer.weight)
    return network


def told_uniad() -> UniAD:
    network = uniad.learner()
    for said in (network.planning_head.motion_teller, network.planning_head.front_reader):
        assert said is not None
        nn.init.normal_(said.tell.weight)
    return network.eval()


LEARNERS = {
    "vad": Learner(
        told_vad,
        vad_objective.VADObjective,
        VADPlannerObjective,
        road_frames.a_frame,
        vad_objective.network_inputs,
        lambda network, inputs: network(inputs).plan,
        lambda name: name.startswith((*PERCEPTION, FRONT_BACKBONE_PREFIX)),
        frozenset({"tell.weight", "tell.bias", "tell_change.weight"}),
    ),
    "uniad": Learner(
        told_uniad,
        UniADObjective,
        UniADPlannerObjective,
        uniad.a_frame,
        uniad_losses.network_inputs,
        lambda network, inputs: network.predict(inputs).plan.positions_m,
        lambda name: not name.startswith("planning_head."),
        frozenset({"tell.weight", "tell.bias"}),
    ),
    "sparsedrive": Learner(
        lambda: sparse.network("sparsedrive", replace(sparse.TINY, plan_sees_front=18, front_eyes=True)).eval(),
        sparse_phases.SparseObjective,
        sparse_phases.SparsePlannerObjective,
        sparse.frame,
        sparse_phases.network_inputs,
        lambda network, inputs: network(inputs).plan,
        lambda name: name.startswith((*sparse_phases.PERCEPTION, FRONT_BACKBONE_PREFIX)),
        forgets="forecast",
    ),
}
of_every_network = pytest.mark.parametrize("learner", LEARNERS.values(), ids=list(LEARNERS))


def total(losses: Losses) -> Tensor:
    return torch.stack(list(losses.values())).sum()


def looked_at(learner: Learner, frames: list[TrainingFrame]) -> tuple[Any, CachedFrames]:
    objective = learner.planner(learner.network())
    store, _ = objective.look(OneScene(frames), range(len(frames)))
    assert isinstance(store, CachedFrames)
    return objective, store


MINIATURES: dict[str, Callable[[], Any]] = {
    "vad": lambda: VADPlanner(VAD(VADConfig.miniature()), name="a", normalisation=RGB_MEAN_STD, device="cpu"),
    "uniad": lambda: UniADPlanner(
        UniAD(UniADConfig.miniature(), solver=None), name="a", normalisation=RGB_MEAN_STD, device="cpu"
    ),
    "sparsedrive": lambda: SparsePlanner(
        SparseDrive(replace(SparseConfig.miniature(), memory_crosses_scenes=False)),
        name="a",
        normalisation=RGB_MEAN_STD,
        device="cpu",
    ),
}


@pytest.mark.parametrize("name", LEARNERS)
def test_training_reads_what_the_planner_reads(name: str, data: NuScenesData, store: FrameStore) -> None:
    planner = MINIATURES[name]()
    read = planner._inputs if name == "vad" else planner.inputs
    for observation in islice(data.observations(store.scenes[0]), 3):
        planned, learned = read(observation), LEARNERS[name].inputs(store.frame(observation.index))
        for field in fields(planned):
            seen, taught = getattr(planned, field.name), getattr(learned, field.name)
            if field.name == "images":
                # Stored pixels are whole numbers.
                assert seen.shape == taught.shape == (6, 3, 128, 224)
                assert float((seen - taught).abs().max()) < 0.51 / min(RGB_MEAN_STD.std) + 1e-3
            elif isinstance(seen, Tensor):
                torch.testing.assert_close(seen, taught.to(seen.dtype), rtol=1e-5, atol=1e-5, msg=field.name)
            else:
                assert seen == pytest.approx(taught) if isinstance(seen, float) else seen == taught, field.name


NOTHING = {"box", "line", "forecast", "occupancy", "map mask", "plan", "plan aside", "plan chosen", "plan class"}
"""Losses that need something annotated."""


@pytest.mark.parametrize("alone", [False, True])
@of_every_network
def test_frames_without_annotations_only_teach_that_nothing_is_there(learner: Learner, alone: bool) -> None:
    clip = [empty(learner.frame(number)) for number in range(2)]
    if alone:
        objective, store = looked_at(learner, clip)
        clip = store.clip(1, 1)
    else:
        objective = learner.objective(learner.network())
    losses = objective.losses(clip)
    assert all(bool(torch.isfinite(loss)) for loss in losses.values())
    # UniAD follows the ego, which always has a box.
    nothing = NOTHING - ({"box"} if learner is LEARNERS["uniad"] else set())
    assert "plan" in losses and not any(float(losses[name].detach()) for name in nothing & losses.keys())
    total(losses).backward()  # type: ignore[no-untyped-call]
    gradients = [weight.grad for weight in objective.network.parameters() if weight.grad is not None]
    assert gradients and all(bool(gradient.isfinite().all()) for gradient in gradients)


@of_every_network
def test_the_plan_learns_alone(learner: Learner) -> None:
    objective, store = looked_at(learner, [learner.frame(number) for number in range(3)])
    total(objective.losses(store.clip(1, 1))).backward()  # type: ignore[no-untyped-call]
    learned = {name for name, weight in objective.network.named_parameters() if weight.grad is not None}
    assert learned and not any(map(learner.stays, learned))
    if learner.told is not None:
        # What is read in the front camera stays, what it tells the plan learns.
        assert {name.split("front_reader.")[1] for name in learned if "front_reader." in name} == learner.told


@of_every_network
def test_some_of_what_is_remembered_is_forgotten_in_each_step(learner: Learner) -> None:
    objective, store = looked_at(learner, [learner.frame(number) for number in range(3)])

    def loss(seed: int) -> float:
        torch.manual_seed(seed)
        return float(objective.losses(store.clip(2, 3))[learner.forgets].detach())

    objective.network.eval()
    assert loss(0) == loss(1)
    objective.network.train()
    assert loss(0) == loss(0) != loss(1)


def vad_expected(network: VAD, frame: TrainingFrame) -> Losses:
    losses = vad_objective.frame_losses(network, network.predict(vad_objective.network_inputs(frame)), frame)
    return {name: vad_objective.WEIGHTS[name] * loss for name, loss in losses.items()}


def uniad_expected(network: UniAD, frame: TrainingFrame) -> Losses:
    return uniad_plan_losses(network.predict(uniad_losses.network_inputs(frame)).plan, frame)


@pytest.mark.parametrize(
    ("name", "expected", "named", "close"),
    [
        ("vad", vad_expected, {"forecast", "mode", "plan", "lane"}, 1e-4),
        ("uniad", uniad_expected, {"plan", "plan aside", "plan agents", "plan boundary"}, 2e-2),
    ],
)
def test_losses_of_the_plan_alone_are_those_of_the_network_that_runs(
    name: str, expected: Callable[[Any, TrainingFrame], Losses], named: set[str], close: float
) -> None:
    frames = [LEARNERS[name].frame(number) for number in range(3)]
    objective, store = looked_at(LEARNERS[name], frames)
    network = objective.network.eval()
    network.reset()
    for number, frame in enumerate(frames):
        with torch.no_grad():
            wanted, found = expected(network, frame), objective.losses(store.clip(number, 1))
        assert named <= set(found) <= set(wanted)
        for key, loss in found.items():
            torch.testing.assert_close(loss, wanted[key], rtol=close, atol=close, msg=key)


@of_every_network
def test_plans_follow_the_front_camera_once_it_has_a_say(learner: Learner) -> None:
    network = learner.network()
    (reader,) = [module for module in network.modules() if isinstance(module, FrontReader)]
    inputs = learner.inputs(learner.frame(0))
    images = inputs.images.clone()
    images[0] += 1.0
    plans = []
    for say in (0.0, 1.0, 5.0):
        reader.zero_message()
        nn.init.normal_(reader.tell.weight, 0.0, say, generator=torch.Generator().manual_seed(0))
        for seen in (inputs, replace(inputs, images=images)):
            network.reset()
            with torch.inference_mode():
                plans.append(learner.plan(network, seen))
    assert not torch.allclose(plans[0], plans[2]) and not torch.allclose(plans[2], plans[4])
    moved = [float((one - other).abs().max()) for one, other in zip(plans[::2], plans[1::2], strict=True)]
    assert moved[0] < moved[2]


# --- learning by heart

Step = Callable[[int], Losses]


def vad_by_heart() -> tuple[VAD, list[TrainingFrame], Step]:
    config = replace(SMALL_VAD, encoder_layers=1, decoder_layers=1, channels=32, backbone_outputs=(2,))
    network = VAD(replace(config, pyramid_levels=1))
    spread = torch.stack([torch.linspace(0.35, 0.65, 12), torch.linspace(0.5, 0.75, 12)], -1)
    set_first_values(network, spread, spread[::2][:5], torch.zeros(3, 6, 2))
    frames = [road_frames.a_frame(0), road_frames.a_frame(0, "b", speed=2.0, aside=0.8)]
    objective = vad_objective.VADObjective(network)
    return network, frames, lambda step: objective.losses([frames[step % 2]])


def uniad_by_heart() -> tuple[UniAD, list[TrainingFrame], Step]:
    objective = UniADObjective(uniad.learner())
    frames = [uniad.a_frame(0, "a"), uniad.a_frame(0, "b")]

    def losses(step: int) -> Losses:
        both = [objective.clip_losses([frame], 0.0, True) for frame in frames]
        return {name: (both[0][name] + both[1][name]) / 2 for name in both[0]}

    return objective.network, frames, losses


def sparse_by_heart(name: str) -> tuple[Any, list[TrainingFrame], Step]:
    network = sparse.network(name)
    objective = sparse_phases.SparseObjective(network)
    frames = [sparse.frame(0, "straight"), replace(sparse.frame(0, "turn", turn=0.2), command=0)]
    return network, frames, lambda step: objective.losses_of([[frame] for frame in frames])


BY_HEART: dict[str, tuple[Callable[[], tuple[Any, list[TrainingFrame], Step]], float]] = {
    "vad": (vad_by_heart, 2e-3),
    "uniad": (uniad_by_heart, 4e-3),
    "sparsedrive": (lambda: sparse_by_heart("sparsedrive"), 6e-3),
    "diffusiondrive": (lambda: sparse_by_heart("diffusiondrive"), 6e-3),
}
WHOLE = 120
"""Steps until two frames are known by heart."""


@pytest.mark.parametrize(
    ("name", "steps"),
    [*((name, 6) for name in BY_HEART), *(pytest.param(n, WHOLE, marks=pytest.mark.slow) for n in BY_HEART)],
)
def test_two_frames_are_learned_by_heart(name: str, steps: int) -> None:
    """In a few steps the losses fall, in many the plan is the one that was driven."""
    torch.manual_seed(0)
    build, rate = BY_HEART[name]
    network, frames, losses = build()
    weights = [weight for weight in network.parameters() if weight.requires_grad]
    optimiser = torch.optim.AdamW(weights, rate)
    history = []
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = rate * (1 - step / steps)
        optimiser.zero_grad(set_to_none=True)
        found = losses(step)
        total(found).backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(weights, 5.0)
        optimiser.step()
        history.append(sum(float(loss.detach()) for key, loss in found.items() if key != "occupancy"))
    first, last = sum(history[:2]), sum(history[-2:])
    if steps < WHOLE:
        assert last < 0.9 * first
        return
    assert last < first / 5
    learner = LEARNERS.get(name, LEARNERS["sparsedrive"])
    for frame in frames:
        network.reset()
        with torch.inference_mode():
            plan = learner.plan(network, learner.inputs(frame))
        assert float((plan - frame.ego_future).norm(dim=-1).mean()) < 0.3
