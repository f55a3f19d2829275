"""What the miniatures see, and whether they need to: the figures that `docs/miniatures.md` is measured against.

Run as ``python bench/miniatures_seeing.py``, with ``--model`` and ``--weights`` (of the only model) to choose. On val
of the embedded data set each miniature plans three times, with its own images, with blank ones and with those of
another scene. Of its forecasts: recall and precision over the vehicles within 30 m that are at least 40 % visible, and
the error of the matched ones beside that of standing still (aims: 70 %, 50 %, below a half). Of its plans: L2 and
collisions, and how much more of both there is without its own images, with the 95 % interval of the paired difference
over scenes (aim: above 0). Who starts a metre later than was recorded is hit from behind by whoever was recorded
there: so the collisions that are the ego's fault (`docs/severity.md`) stand apart as well.

``--data ROOT --split train --forecast-score 0.25 --forecast-score 0.3`` is how a miniature's least score of a forecast
is chosen: on scenes of a town that it has not learned from, the one with the largest F1.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from adapters.camera_inputs import RGB_MEAN_STD
from adapters.checkpoints.cache import load_weights
from adapters.checkpoints.importing import resolve_checkpoint
from adapters.extensions.training.plan_figures import Difference, Images, JudgedPlans, Loss, judged_plans
from adapters.models import miniature, miniatures, resolve
from benchmark.datasets.roots import DataSet, open_data
from benchmark.fairness.plan_severity import plan_severities
from benchmark.geometry import Floats
from benchmark.machine.workers import single_threaded
from benchmark.machine.workspace import cache_root
from benchmark.metrics.rates import ratios_over_scenes
from benchmark.pdm.layers import road_of, route_of
from generation.sources.mini import TownSettings, build_town


def built(name: str, weights: Path | None, forecast_score: float | None) -> Any:
    """A miniature with given weights and a given least score of a forecast, or its own."""
    small = miniature(name)
    network = small.build()
    load_weights(network, resolve_checkpoint(name, weights or small.packaged))
    if forecast_score is not None:
        reporting = replace(network.config.reporting, least_score=forecast_score)
        network.config = replace(network.config, reporting=reporting)
    return resolve(small.planner)(network, name=name, normalisation=RGB_MEAN_STD, device="cpu")


def forecasts_line(judged: JudgedPlans) -> str:
    """What is seen, and how well it is known where it goes."""
    seen = judged.as_seen()
    if seen is None:
        return "no forecasts"
    f1 = 2 * seen.recall * seen.precision / (seen.recall + seen.precision)
    share = seen.likeliest_error_m / seen.standing_error_m
    return (
        f"recall {seen.recall:.1%}, precision {seen.precision:.1%}, F1 {f1:.3f} of {seen.vehicles:,} vehicles; error "
        f"{seen.likeliest_error_m:.2f} m (best mode {seen.least_error_m:.2f} m), {share:.2f} of standing still"
    )


def blamed(judged: JudgedPlans, data: DataSet) -> Floats:
    """(S,) 1 where a plan touches somebody within 3 s by the ego's fault."""
    found: list[bool] = []
    for name, group in groupby(zip(judged.truths, judged.plans, strict=True), key=lambda pair: pair[0].scene):
        scene, pairs = data.scene(name), list(group)
        plans = np.array([plan.waypoints_in_lidar(truth.lidar_ahead_m) for truth, plan in pairs])
        road = road_of(scene.road_map, route_of(scene.ego.pose))
        rows = plan_severities([truth for truth, _ in pairs], plans, road)
        found += [row.contact is not None and bool(row.contact.at_fault) for row in rows]
    return np.array(found, np.float64)


def measure(name: str, weights: Path | None, data: DataSet, scenes: Sequence[str]) -> None:
    """Print the figures of one miniature."""
    shown = {
        images: judged_plans(built(name, weights, None), data, scenes, images=images)
        for images in Images
        if images is not Images.SHUFFLED or len(scenes) > 1
    }
    own = shown.pop(Images.OWN)
    print(f"{name}: {forecasts_line(own)}")
    found, own_fault = own.figures(), blamed(own, data)
    places = [truth.scene for truth in own.truths]
    print(
        f"  own images: L2 at 3 s {found.l2_3s_m:.2f} m, collisions {found.collisions:.1%} of {found.samples} samples, "
        f"{own_fault.mean():.1%} by its fault"
    )
    for images, judged in shown.items():
        more = 100.0 * (blamed(judged, data) - own_fault)[:, None]
        rate = ratios_over_scenes(more, np.ones_like(more), places, seed=0)[0]
        fault = Difference.of(rate).said(1)
        print(f"  {images.value}: {Loss.between(own, judged).said()}, by its fault {fault} points", flush=True)


def main() -> None:
    """Measure those that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = [name for name, small in miniatures().items() if small.packaged.is_file()]
    parser.add_argument("--model", action="append", choices=known)
    parser.add_argument("--weights", type=Path, help="Another weights file of the only model.")
    parser.add_argument("--data", type=Path, help="Another data set than the embedded one.")
    parser.add_argument("--split", default="val")
    parser.add_argument("--forecast-score", type=float, action="append", help="Measure the forecasts alone, with this.")
    chosen = parser.parse_args()
    names = chosen.model or known
    if chosen.weights is not None and len(names) != 1:
        parser.error("--weights are those of one --model")
    single_threaded()
    town = TownSettings()
    root = chosen.data or build_town(cache_root() / town.folder_name("mini"), town, workers=1)
    data = open_data(root)
    scenes = data.scene_names(chosen.split)
    for name in names:
        for score in chosen.forecast_score or ():
            judged = judged_plans(built(name, chosen.weights, score), data, scenes)
            print(f"{name}, forecasts from {score:g}: {forecasts_line(judged)}", flush=True)
        if not chosen.forecast_score:
            measure(name, chosen.weights, data, scenes)


if __name__ == "__main__":
    main()
