"""The built-in golden set of the PDM sub-scores: a made-up crossing, judged by the slow version.

``python -m tests.benchmark.extensions.golden_sets.golden_pdm`` writes it again; a test compares. It has the form of the
official sets, so that `challenger-bench verify pdm` reads both alike. The first plan of each sample stands for the
recorded future.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.golden_sets.pdm import BUILT_IN
from benchmark.extensions.golden_sets.pdm.golden_set import VEHICLE
from benchmark.geometry import Floats
from benchmark.pdm.road_polygons import SurfaceKind
from tests.benchmark.pdm.cases import Case, crossing, slow_objects
from tests.benchmark.pdm.slow_motion import slow_direct, slow_motion, slow_poses, slow_profiles
from tests.benchmark.pdm.slow_pdm import (
    BOUNDS,
    SlowSample,
    SlowVerdict,
    ego_rectangle,
    rectangle,
    slow_agreement,
    slow_differences,
    slow_history,
    slow_progress,
    slow_score,
    slow_states_verdict,
    slow_track,
)

SEED, SAMPLES, OBJECTS = 1, 2, 14
PLAN_NAMES = ("recorded", "left", "right", "faster", "braking", "far-left", "standing", "reverse", "wander", "turn")
NAMES = ("nc", "dac", "ddc", "ttc", "lk", "hc")
LAYERS = tuple(SurfaceKind)
Arrays = dict[str, NDArray[Any]]


def golden_arrays() -> Arrays:
    """Every array of the set."""
    case = crossing(SEED, samples=SAMPLES, objects=OBJECTS)
    # The two are taken for consecutive samples: only EC looks at both, and any two motions will do.
    with_area = np.array([True, False])
    return {
        **_inputs(case, with_area),
        **_objects(case),
        **_motions(case),
        **_judged(case, with_area, "lqr", slow_motion),
        **_judged(case, with_area, "direct", slow_direct),
    }


def sample_of(case: Case, with_area: NDArray[np.bool_], number: int) -> SlowSample:
    """One sample; some do without the drivable area."""
    area = bool(with_area[number])
    surfaces = [each for each in case.surfaces if area or each[0] is not SurfaceKind.DRIVABLE_AREA]
    return replace(case, surfaces=surfaces).slow(number)


def _inputs(case: Case, with_area: NDArray[np.bool_]) -> Arrays:
    rings = [
        (number, hole, np.array(ring.coords)[:-1])
        for number, (_, shape, _) in enumerate(case.surfaces)
        for hole, ring in ((False, shape.exterior), *((True, inner) for inner in shape.interiors))
    ]
    return {
        "vehicle": np.array(VEHICLE),
        "plan_names": np.array(PLAN_NAMES),
        "layer_names": np.array([layer.value for layer in LAYERS]),
        "pair": np.zeros(SAMPLES, np.int64),
        "ego_initial_state": case.now,
        "history_keyframes": case.past,
        "history_rows": np.array([slow_history(past) for past in case.past]),
        "plans": case.plans,
        "centerline": case.route,
        "uses_drivable_area": with_area,
        "poly_layer": np.array([LAYERS.index(layer) for layer, _, _ in case.surfaces]),
        "poly_on_route": np.array([routed for _, _, routed in case.surfaces]),
        "ring_xy": np.concatenate([points for _, _, points in rings]),
        "ring_offset": np.concatenate([[0], np.cumsum([len(points) for _, _, points in rings])]),
        "ring_poly": np.array([number for number, _, _ in rings]),
        "ring_is_hole": np.array([hole for _, hole, _ in rings]),
    }


def _objects(case: Case) -> Arrays:
    frames = case.key_frames
    box, velocity = np.zeros((len(frames.box), 31, 3)), np.zeros((len(frames.box), 31, 2))
    there, removed = np.zeros((len(frames.box), 31), np.bool_), np.zeros(len(frames.box), np.bool_)
    for sample, now in enumerate(case.now):
        first = int(frames.offsets[sample])
        for number, thing in enumerate(slow_objects(frames, sample), start=first):
            poses, velocities = slow_track(thing)
            for state, pose in enumerate(poses):
                if pose is not None:
                    there[number, state], box[number, state], velocity[number, state] = True, pose, velocities[state]
            shape = None if poses[0] is None else rectangle(*poses[0], thing.length, thing.width)
            removed[number] = shape is not None and shape.intersects(ego_rectangle(now))
    return {
        "obj_offset": frames.offsets,
        "obj_type": np.where(frames.is_agent, 0, 6),
        "obj_size": frames.size,
        "obj_key_box": frames.box,
        "obj_key_valid": frames.annotated,
        "obj_key_velocity": frames.velocity,
        "obj_box": box,
        "obj_valid": there,
        "obj_velocity": velocity,
        "obj_removed": removed,
    }


def _motions(case: Case) -> Arrays:
    poses = [[slow_poses(plan, now) for plan in plans] for plans, now in zip(case.plans, case.now)]
    profiles = np.array([[slow_profiles(each) for each in of_sample] for of_sample in poses])
    return {
        "plan_states": np.array(poses),
        "lqr_velocity_profile": profiles[:, :, 0],
        "lqr_curvature_profile": profiles[:, :, 1],
    }


def _judged(case: Case, with_area: NDArray[np.bool_], mode: str, motion: Any) -> Arrays:
    samples = [sample_of(case, with_area, number) for number in range(len(case.now))]
    states = np.array([[motion(plan, now) for plan in plans] for plans, now in zip(case.plans, case.now)])
    found = [[slow_states_verdict(each, sample) for each in of_sample] for of_sample, sample in zip(states, samples)]
    pair = [slow_differences(earlier, later, 5) for earlier, later in zip(*states)]
    differences = np.array([pair, pair])

    def each(value: Any) -> NDArray[Any]:
        return np.array([[value(verdict) for verdict in of_sample] for of_sample in found])

    def beside(value: Any) -> NDArray[Any]:
        return np.array([[value(verdict, of_sample[0]) for verdict in of_sample] for of_sample in found])

    ec = np.array([[slow_agreement(pair.tolist()) for pair in of_sample] for of_sample in differences])
    ep = beside(slow_progress)
    arrays = {
        "states": states,
        "areas": each(lambda verdict: _places(verdict, "multiple lanes", "non-drivable", "oncoming")),
        "in_intersection": each(lambda verdict: _places(verdict, "in intersection", "axle in intersection")),
        **{name: each(lambda verdict, name=name: getattr(verdict, name)) for name in NAMES},
        "ep": ep,
        "ep_alone": np.ones_like(ep),
        "ec": ec,
        "ec_rms": differences,
        "multiplier": each(lambda verdict: verdict.multiplier),
        "collision_step": each(lambda verdict: verdict.collision_step),
        "ttc_step": each(lambda verdict: verdict.ttc_step),
        "progress_m": each(lambda verdict: verdict.progress_m),
        "reference_progress_m": beside(lambda verdict, reference: reference.progress_m),
        "reference_multiplier": beside(lambda verdict, reference: reference.multiplier),
        "ddc_max_m": each(lambda verdict: verdict.wrong_way_m),
        "lk_offset_m": each(lambda verdict: verdict.offset_m),
        "hc_extremes": each(lambda verdict: verdict.extremes),
        "hc_checks": each(
            lambda verdict: [low < a and b < high for (low, high), (a, b) in zip(BOUNDS, verdict.extremes)]
        ),
        "nc_events": _events(found, "nc_events", 6),
        "ttc_events": _events(found, "ttc_events", 8),
        "score_without_ec_alone": each(lambda verdict: slow_score(verdict, 1.0, None)),
        **_totals(found, ep, ec),
    }
    named = {f"{mode}_{name}": values for name, values in arrays.items()}
    return {**named, **(_filtered(samples, found, ep, ec) if mode == "lqr" else {})}


def _places(verdict: SlowVerdict, *names: str) -> list[list[bool]]:
    return [[place[name] for name in names] for place in verdict.places]


def _events(found: list[list[SlowVerdict]], name: str, width: int) -> NDArray[np.int64]:
    rows = [
        (sample, plan, *event)
        for sample, of_sample in enumerate(found)
        for plan, verdict in enumerate(of_sample)
        for event in getattr(verdict, name)
    ]
    return np.array(rows, np.int64).reshape(-1, width)


def _totals(found: list[list[SlowVerdict]], ep: Floats, ec: Floats) -> Arrays:
    pairs = [list(zip(*rows)) for rows in zip(found, ep, ec)]
    return {
        "score": np.array([[slow_score(verdict, own, both) for verdict, own, both in rows] for rows in pairs]),
        "score_without_ec": np.array([[slow_score(verdict, own, None) for verdict, own, _ in rows] for rows in pairs]),
    }


def _filtered(samples: list[SlowSample], found: list[list[SlowVerdict]], ep: Floats, ec: Floats) -> Arrays:
    """The recorded future alone and without a history; what it fails is 1 for every plan."""
    human = [
        slow_states_verdict(of_sample[0].states, replace(sample, past=None))
        for of_sample, sample in zip(found, samples)
    ]
    by_name: Arrays = {f"human_{name}": np.array([getattr(each, name) for each in human]) for name in NAMES}
    by_name["human_ep"] = np.ones(len(human))
    for name in NAMES:
        values = [
            [1.0 if getattr(driver, name) == 0.0 else getattr(verdict, name) for verdict in of_sample]
            for driver, of_sample in zip(human, found)
        ]
        by_name[f"filtered_{name}"] = np.array(values)
    by_name["filtered_ep"] = ep
    product = by_name["filtered_nc"] * by_name["filtered_dac"] * by_name["filtered_ddc"]
    by_name["filtered_multiplier"] = product
    weighted = 5 * ep + 5 * by_name["filtered_ttc"] + 2 * by_name["filtered_lk"] + 2 * by_name["filtered_hc"] + 2 * ec
    by_name["filtered_score"] = product * weighted / 16
    return by_name


def write(folder: Path = BUILT_IN) -> None:
    """Write the set."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / "crossing.npz", **golden_arrays())


if __name__ == "__main__":
    write()
