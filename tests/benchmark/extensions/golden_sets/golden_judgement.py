"""The built-in golden sets of drivers, severity and realism.

``python -m tests.benchmark.extensions.golden_sets.golden_judgement`` writes them again. What is official, or of made-up
tracks and from the other implementation of the definitions, is thinned out of the sets beside this repository. Recorded
tracks do not go into it: the scenes are made up here, and what is said of them holds this implementation to what it
said before.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.golden_sets.drivers import BUILT_IN as DRIVERS
from benchmark.extensions.golden_sets.realism import BUILT_IN as REALISM
from benchmark.extensions.golden_sets.realism.motion import pool_features
from benchmark.extensions.golden_sets.severity import BUILT_IN as SEVERITY
from benchmark.fairness.ctg import (
    CtgMask,
    CtgNormalisation,
    CtgVersion,
    SceneTracks,
    bin_edges,
    compute_deviations,
    compute_histograms,
)
from benchmark.fairness.features import FEATURES, FeatureRun, extract_recorded_runs, extract_runs
from benchmark.fairness.realism import Histograms, equal_bins, quantile_bins, w1
from benchmark.geometry import Floats
from benchmark.interactions.driver_outcomes import CollisionChecker, DriverOutcome
from benchmark.interactions.driver_simulation import (
    REFERENCE_DRIVER_KINDS,
    DrivingSituation,
    ReferenceDriver,
    find_first_visible_time,
    simulate_drivers,
)
from benchmark.interactions.reaction import Driver
from benchmark.interactions.tracks import ContinuousTracks
from tests.benchmark.extensions.golden_sets.altered import load
from tests.benchmark.interactions.made import along_bend, made_scene

SHARED = Path(__file__).resolve().parents[5] / "shared" / "golden"
ENCOUNTERS = ("cut_in", "arc_leader_brakes", "from_behind", "crossing_other_first")
Arrays = dict[str, NDArray[Any]]


def thinned_drivers() -> tuple[dict[str, Arrays], dict[str, Any]]:
    """Arrays and JSON by file, from the set beside this repository."""
    held = {path.stem: load(path) for path in (SHARED / "drivers").glob("*.npz")}
    straight, following, low_speed = held["straight"], held["tables_following"], held["tables_low_speed"]
    cases, rows = len(straight["family"]), len(following["speed_km_h"])
    thin = {
        "pairs_km_h": low_speed["pairs_km_h"][::5],
        "models": low_speed["models"],
        "gap": low_speed["gap"][::6],
        "lateral_speed": low_speed["lateral_speed"][2::4],
        "crash": low_speed["crash"][::5, :, ::6, 2::4],
    }
    arrays = {
        "straight": {k: v[::17] if len(v) == cases else v for k, v in straight.items()},
        "functions": {k: v[::8] if k != "idm_parameters" else v for k, v in held["functions"].items()},
        "tables_following": {k: v[..., ::37] if v.shape[-1] == rows else v for k, v in following.items()},
        "tables_low_speed": thin,
        "encounters": _some_encounters("drivers"),
    }
    return arrays, {"encounters": _some_facts("drivers")}


def thinned_severity() -> tuple[dict[str, Arrays], dict[str, Any]]:
    """Arrays and JSON by file, from the set beside this repository."""
    folder, facts = SHARED / "severity", _some_facts("severity")
    contacts = json.loads((folder / "contacts.json").read_text())
    contacts["cases"] = contacts["cases"][::3]
    manoeuvres = {k: v for k, v in load(folder / "manoeuvres.npz").items() if k.startswith("cut_in/")}
    for each in facts:
        # Costs the most by far, and says the same as the evaluations.
        each.get("last_chance", {}).pop("scan", None)
    arrays = {"encounters": _some_encounters("severity"), "manoeuvres": manoeuvres}
    return arrays, {"contacts": contacts, "encounters": facts}


def _some_encounters(kind: str) -> Arrays:
    held = load(SHARED / kind / "encounters.npz")
    return {k: v for k, v in held.items() if k.split("/")[0] in ENCOUNTERS}


def _some_facts(kind: str) -> list[dict[str, Any]]:
    facts = json.loads((SHARED / kind / "encounters.json").read_text())
    return [each for each in facts if each["name"] in ENCOUNTERS]


def made_driver_scenes() -> tuple[Arrays, list[dict[str, Any]]]:
    """``scenes.npz`` and ``scenes.json``: two scenes with an adversary each, and what the drivers make of them."""
    arrays: Arrays = {}
    facts = []
    for number, kind in ((0, "cut_in"), (1, "brake")):
        tracks, name, index = _first(made_scene(number)[0], 91), f"made-{number}", 6
        speed, radius = 7.0 + number, 60.0 + 20.0 * number
        sideways = np.clip(3.5 - 1.2 * np.maximum(tracks.seconds - 1.0, 0.0), 0.0, 3.5) if kind == "cut_in" else 0.0
        slower = 3.0 if kind == "cut_in" else np.minimum(tracks.seconds, speed / 4.0) * 2.0
        added = np.round(along_bend(tracks.seconds, 10.0, sideways, speed - slower, radius, (4.6, 1.9)), 6)
        fields = {"seconds": tracks.seconds, "ego": tracks.ego, "agents": tracks.agents, "valid": tracks.valid}
        arrays |= {f"{name}/{field}": array for field, array in fields.items()}
        arrays |= {f"{name}/categories": np.array(tracks.categories), f"{name}/{kind}": added}
        whole = ContinuousTracks(
            tracks.seconds,
            tracks.ego,
            np.concatenate([tracks.agents, added[None]]),
            np.concatenate([tracks.valid, np.ones((1, 91), np.bool_)]),
            (*tracks.categories, "vehicle.car"),
        )
        rungs = {
            **{driver.value: ReferenceDriver(driver) for driver in REFERENCE_DRIVER_KINDS},
            "cc_adversary_only": ReferenceDriver(Driver.CC, True),
        }
        situation = DrivingSituation.of(whole, adversary=index)
        found = map(CollisionChecker.of(situation).find_outcome, simulate_drivers(situation, list(rungs.values())))
        drivers = {name: _outcome(outcome) for name, outcome in zip(rungs, found)}
        seen = find_first_visible_time(whole, index, situation.times)
        facts.append({"scene": name, "adversary": kind, "index": index, "drivers": drivers, "first_visible": seen})
    return arrays, facts


def made_realism() -> tuple[dict[str, Arrays], dict[str, Any]]:
    """Every file of the realism set but the made-up samples, which are stored elsewhere already."""
    chosen = {"scene-made-0": 0, "scene-made-1": 1}
    files: dict[str, Arrays] = {}
    features: Arrays = {}
    runs: dict[str, dict[str, list[FeatureRun]]] = {"recorded": {}, "swerving": {}}
    positions: dict[str, list[SceneTracks]] = {"recorded": [], "rotated": []}
    inputs: Arrays = {}
    for number, (name, agent) in enumerate(chosen.items()):
        tracks, keyframes = made_scene(number)
        files[name] = _scene_arrays(tracks, keyframes)
        changed = tracks.agents.copy()
        changed[agent, :, 1] += 0.5 * np.sin(2 * np.pi * tracks.seconds / 4.0)
        features[f"swerving/{name}/{agent}/boxes"] = changed[agent]
        runs["recorded"][name] = extract_recorded_runs(tracks, keyframes, "vehicle.car")
        runs["swerving"][name] = extract_runs(replace(tracks, agents=changed), keyframes, agent)
        for variant, angle in (("recorded", 0.0), ("rotated", 0.7)):
            inputs |= _ctg_input(tracks, name, variant, angle)
            positions[variant].append(
                SceneTracks(inputs[f"{name}/{variant}/position"], inputs[f"{name}/{variant}/yaw"])
            )
    for variant, scenes in runs.items():
        features |= _run_arrays(variant, scenes)
    files |= {"ctg_inputs": inputs, "plain_features": features}
    files["ctg_histograms"], deviated = _ctg(positions)
    return files, {"ctg_deviations": deviated, "plain_divergences": _divergences(chosen, runs)}


def write() -> None:
    """Write all three sets."""
    made, facts = made_driver_scenes()
    arrays, texts = thinned_drivers()
    _write(DRIVERS, {**arrays, "scenes": made}, {**texts, "scenes": facts})
    _write(SEVERITY, *thinned_severity())
    arrays, texts = made_realism()
    samples = load(SHARED / "realism" / "plain_arrays.npz")
    golden = json.loads((SHARED / "realism" / "plain_divergences.json").read_text())["arrays"]
    texts["plain_divergences"]["arrays"] = golden
    _write(REALISM, {**arrays, "plain_arrays": samples}, texts)


def _first(tracks: ContinuousTracks, frames: int) -> ContinuousTracks:
    kept = slice(frames)
    return ContinuousTracks(
        tracks.seconds[kept], tracks.ego[kept], tracks.agents[:, kept], tracks.valid[:, kept], tracks.categories
    )


def _outcome(outcome: DriverOutcome) -> dict[str, Any]:
    contact = outcome.contact
    names = ("time", "agent", "ego_speed", "other_speed", "impact_speed")
    hit = contact and {
        **{name: getattr(contact, name) for name in names},
        "type": contact.kind.value,
        "ego_box": contact.ego.tolist(),
        "other_box": contact.other.tolist(),
    }
    return {
        "contact": hit,
        "reacted": outcome.reacted,
        "first_reason": outcome.reason,
        "min_speed": float(outcome.speed.min()),
        "end_station": float(outcome.station[-1]),
        "unsafe_steps": int(outcome.unsafe.sum()),
        "beyond_end": outcome.beyond_end,
        "fragile": False,
    }


def _scene_arrays(tracks: ContinuousTracks, keyframes: NDArray[np.int64]) -> Arrays:
    fields = {name: getattr(tracks, name) for name in ("seconds", "ego", "agents", "valid")}
    return {**fields, "keyframes": keyframes, "categories": np.array(tracks.categories)}


def _run_arrays(variant: str, scenes: dict[str, list[FeatureRun]]) -> Arrays:
    arrays: Arrays = {}
    for name, runs in scenes.items():
        numbers: dict[int, int] = {}
        for run in runs:
            number = numbers[run.agent] = numbers.get(run.agent, -1) + 1
            label = f"{variant}/{name}/{run.agent}/{number}"
            arrays |= {f"{label}/time": run.times, **{f"{label}/{key}": run.values[key] for key in FEATURES}}
    return arrays


def _divergences(chosen: dict[str, int], runs: dict[str, dict[str, list[FeatureRun]]]) -> dict[str, Any]:
    pools = {variant: {name: pool_features(some) for name, some in scenes.items()} for variant, scenes in runs.items()}

    def pool(variant: str, scenes: list[str], feature: str) -> Floats:
        return np.concatenate([pools[variant][name][feature] for name in scenes])

    names = list(chosen)
    facts: dict[str, Any] = {"chosen": chosen, "features": list(FEATURES)}
    for variant in ("swerving", "recorded", "halves"):
        halves = variant == "halves"
        samples = {
            feature: (
                pool("recorded" if halves else variant, names[::2] if halves else names, feature),
                pool("recorded", names[1::2] if halves else names, feature),
            )
            for feature in FEATURES
        }
        facts[variant] = {feature: _divergence(*both) for feature, both in samples.items()}
        for key, bins in (("realism", quantile_bins), ("realism_equal_width", equal_bins)):
            facts[variant][key] = float(np.mean([1 - bins(*both).divergence for both in samples.values()]))
    return facts


def _divergence(sample: Floats, reference: Floats) -> dict[str, Any]:
    quantile, equal = quantile_bins(sample, reference), equal_bins(sample, reference)

    def counts(bins: Histograms, name: str) -> dict[str, Any]:
        return {name: bins.counts.tolist(), f"{name}_reference": bins.reference.tolist()}

    return {
        "w1": w1(sample, reference),
        "jsd_quantile": quantile.divergence,
        "quantile_edges": quantile.edges.tolist(),
        **counts(quantile, "quantile_counts"),
        "jsd": equal.divergence,
        "low": float(equal.edges[0]),
        "high": float(equal.edges[1]),
        **counts(equal, "counts"),
    }


def _ctg_input(tracks: ContinuousTracks, name: str, variant: str, angle: float) -> Arrays:
    times = 0.1 * np.arange(101)
    found, _ = tracks.agents_at(times)
    cars = np.concatenate([tracks.ego_at(times)[None], found[[0, 1, 3]]])
    x, y = cars[..., 0] + 3.0, cars[..., 1] + 5.0
    cos, sin = np.cos(angle), np.sin(angle)
    position = np.round(np.stack([x * cos - y * sin, x * sin + y * cos], axis=-1), 6)
    return {
        f"{name}/{variant}/position": position,
        f"{name}/{variant}/yaw": np.round(cars[..., 4] + angle, 6),
    }


def _ctg(positions: dict[str, list[SceneTracks]]) -> tuple[Arrays, dict[str, Any]]:
    edges = bin_edges()
    arrays: Arrays = {f"edges/{name}": values for name, values in edges.items()}
    facts: dict[str, Any] = {}
    settings = [(version, CtgNormalisation.SCENE, CtgMask.NONE) for version in CtgVersion]
    settings += [
        (CtgVersion.CTG, CtgNormalisation.DATASET, CtgMask.CURRENT_SPEED),
        (CtgVersion.MTD, CtgNormalisation.SCENE, CtgMask.ANY_SPEED),
    ]
    for setting in settings:
        found = {variant: compute_histograms(scenes, *setting, edges) for variant, scenes in positions.items()}
        label = "/".join(setting)
        for variant, shares in found.items():
            arrays |= {f"{label}/{variant}/{name}": values for name, values in shares.items()}
        facts[label] = {"rotated": compute_deviations(found["rotated"], found["recorded"], edges)}
    return arrays, facts


def _write(folder: Path, arrays: dict[str, Arrays], texts: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, held in arrays.items():
        np.savez_compressed(folder / f"{name}.npz", **held)
    for name, facts in texts.items():
        (folder / f"{name}.json").write_text(json.dumps(facts, indent=None, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    write()
