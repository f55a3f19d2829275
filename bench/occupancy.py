"""What UniAD's collision optimiser could do: with the occupancy that `uniad-mini` predicts, and with the true one.

Run as ``python bench/occupancy.py``; ``--weights FILE`` are other weights, ``--split adv`` is another split of the
embedded data set. Each plan before it is optimised is moved away from the cells that are occupied: by the network's own
word, from several probabilities on, and by the annotated vehicles within squares of several sizes, now and up to 2 s
ahead as the network would say it. Printed are plans that touch anybody within 3 s (protocol ``exact``), how many of
them the optimiser repairs and how many others it spoils, and L2 at 3 s. No occupancy is better than the true one.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import torch

import benchmark
from adapters.camera_inputs import RGB_MEAN_STD
from adapters.checkpoints.cache import load_weights
from adapters.checkpoints.importing import resolve_checkpoint
from adapters.models import miniature
from adapters.networks.uniad.collision_optimiser import move_plan
from adapters.networks.uniad.occupancy import CELL_M
from adapters.networks.uniad.planner import UniADPlanner
from benchmark.datasets.roots import DataSet
from benchmark.geometry import Bools, Floats
from benchmark.machine.workers import single_threaded
from benchmark.planning import SceneInfo
from benchmark.protocols import protocol
from benchmark.truth import SampleTruth

NAME = "uniad-mini"
LEVELS = (0.1, 0.15, 0.2, 0.3)
HALVES_M = (6.0, 12.0, 20.0, 32.0, 50.0)


@dataclass(frozen=True, slots=True)
class Planned:
    """A plan before it is optimised, beside what happened.

    Attributes:
        truth: The sample.
        plan: (6, 2) metres, lidar frame.
        probability: (T, rows, columns) that a cell is occupied, as the network says.
    """

    truth: SampleTruth
    plan: Floats
    probability: Floats


def planned(weights: Path | None, data: DataSet, scenes: Sequence[str]) -> list[Planned]:
    """What the network says of every sample whose recording reaches 3 s."""
    small = miniature(NAME)
    network = small.build()
    load_weights(network, resolve_checkpoint(NAME, weights or small.packaged))
    planner = UniADPlanner(network, name=NAME, normalisation=RGB_MEAN_STD, device="cpu")
    found = []
    for name in scenes:
        scene = data.scene(name)
        planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
        for observation, truth in zip(data.observations(name), data.truth(name), strict=True):
            with torch.inference_mode():
                said = network.predict(planner.inputs(observation))
            if truth.complete:
                probability = (said.occupancy.margin + network.config.occupied_above).numpy()
                found.append(Planned(truth, said.plan.positions_m.double().numpy(), probability))
    return found


def true_occupancy(truth: SampleTruth, half_m: float, steps: int) -> Bools:
    """(T, rows, columns) cells whose centres are in annotated vehicles."""
    side = round(2 * half_m / CELL_M)
    axis = (np.arange(side) + 0.5) * CELL_M - half_m
    x, y = np.meshgrid(axis, axis)
    occupied = np.zeros((steps, side, side), np.bool_)
    for agent, category in enumerate(truth.categories):
        for step in np.flatnonzero(truth.annotated[agent, :steps]) if category.startswith("vehicle.") else ():
            middle_x, middle_y, length, width, yaw = truth.boxes[agent, step]
            along = (x - middle_x) * np.cos(yaw) + (y - middle_y) * np.sin(yaw)
            across = (y - middle_y) * np.cos(yaw) - (x - middle_x) * np.sin(yaw)
            occupied[step] |= (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)
    return occupied


def say(words: str, truths: Sequence[SampleTruth], plans: Sequence[Floats], before: Bools | None) -> Bools:
    """Print one line; (S,) which plans touch anybody."""
    outcomes = protocol("exact").evaluate(truths, np.array(plans))
    touch = np.asarray(outcomes.collision.any(-1))
    changed = ""
    if before is not None:
        changed = f", repaired {int((before & ~touch).sum())}, spoiled {int((~before & touch).sum())}"
    print(
        f"{words}: {int(touch.sum())} of {len(touch)}{changed}; L2 at 3 s {outcomes.l2[:, -1].mean():.2f} m", flush=True
    )
    return touch


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", type=Path, help="other weights of uniad-mini")
    parser.add_argument("--split", default="val", help="split of the embedded data set")
    asked = parser.parse_args()
    single_threaded()
    data = benchmark.open_split(benchmark.open_data("mini"), asked.split)
    found = planned(asked.weights, data, data.scene_names(asked.split))
    truths, plans = [each.truth for each in found], [each.plan for each in found]
    before = say("without the optimiser", truths, plans, None)
    for level in LEVELS:
        moved = [move_plan(each.plan, each.probability > level).points for each in found]
        say(f"cells from {level:g} on", truths, moved, before)
    for half in HALVES_M:
        true = (true_occupancy(each.truth, half, len(each.probability)) for each in found)
        moved = [move_plan(plan, cells).points for plan, cells in zip(plans, true, strict=True)]
        say(f"true cells within {half:g} m", truths, moved, before)


if __name__ == "__main__":
    main()
