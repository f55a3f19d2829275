"""The geometry of ``exact`` against verdicts of exact polygons: all objects, and those that each protocol counts."""

from dataclasses import replace
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.golden_sets.protocols.golden_set import ProtocolGoldenScene
from benchmark.extensions.golden_sets.protocols.official import compare_equal
from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, ProtocolOutcomes
from benchmark.protocols.exact import INSTANTS_PER_STEP, compute_plan_boxes, find_contacts, interpolate_footprints
from benchmark.protocols.sparsedrive import find_waypoint_contacts
from benchmark.protocols.stacked_truths import StackedTruths, stack
from benchmark.truth import SampleTruth
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays

_INSTANTS: Final = PLAN_STEPS * INSTANTS_PER_STEP
_FROZEN: Final = ("all", "uniad", "vad")
"""Object sets for which the verdicts with a frozen heading are stored too."""


def compare_polygons(
    comparison: Comparison, scene: ProtocolGoldenScene, exact: GoldenArrays, judged: list[ProtocolOutcomes]
) -> None:
    """Compare contacts at waypoints and every 0.1 s, of plans and recorded ego, and headings of each of the P plans."""
    stacked, shape = stack(scene.truths), scene.plans.shape[:3]
    steps = exact.verdicts("cont_all", *shape[:2], _INSTANTS).reshape(*shape, INSTANTS_PER_STEP).any(axis=-1)
    comparison.same("exact collision", np.stack([outcomes.collision for outcomes in judged], axis=1), steps)
    for objects, present in build_object_sets(stacked).items():
        _compare_set(comparison, scene, exact, stacked, objects, present)
    heading = exact.floats("heading", *shape[:2], PLAN_STEPS + 1)[..., 1:]
    ours = np.stack([PROTOCOLS["exact"].headings(scene.plans[:, plan]) for plan in range(shape[1])], axis=1)
    comparison.numbers("exact heading (rad)", ours, heading, angle=True)


def build_object_sets(truths: StackedTruths) -> dict[str, Bools]:
    """Objects that ``all``, ``uniad``, ``vad`` and ``sd`` count now and at the six steps: (M, 7) verdicts each."""
    counted = {name: PROTOCOLS[name].counted_objects(truths) for name in ("uniad", "vad", "sparsedrive")}
    now = truths.annotated[:, 0]
    before = {
        "uniad": now & counted["uniad"].any(axis=1),
        "vad": now & counted["vad"].any(axis=1),
        "sparsedrive": now & truths.has_lidar_points[:, 0],
    }
    counted_with_present = {name: np.concatenate([before[name][:, None], counted[name]], axis=1) for name in counted}
    return {
        "all": truths.annotated,
        "uniad": counted_with_present["uniad"],
        "vad": counted_with_present["vad"],
        "sd": counted_with_present["sparsedrive"],
    }


def _compare_set(
    comparison: Comparison,
    scene: ProtocolGoldenScene,
    exact: GoldenArrays,
    stacked: StackedTruths,
    objects: str,
    present: Bools,
) -> None:
    plans = [scene.plans[:, plan] for plan in range(len(scene.plan_names))]
    truths, last = _keep_objects(scene.truths, present), slice(INSTANTS_PER_STEP - 1, None, INSTANTS_PER_STEP)
    touching = np.stack([find_contacts(compute_plan_boxes(plan), truths)[0] for plan in plans], axis=1)
    recorded, _ = find_contacts(_recorded_boxes(stacked), truths)
    ours = {
        f"exact contact every 0.1 s, {objects}": (touching, f"cont_{objects}"),
        f"exact contact at waypoints, {objects}": (touching[..., last], f"way_{objects}"),
        f"exact contact of the recorded ego, {objects}": (
            recorded[:, last] & stacked.ego_future_valid,
            f"gt_way_{objects}",
        ),
    }
    if objects == "all":
        valid = np.repeat(stacked.ego_future_valid, INSTANTS_PER_STEP, axis=1)
        ours["exact contact of the recorded ego every 0.1 s"] = (recorded & valid, "gt_cont_all")
    if objects in _FROZEN:
        ahead = np.full((len(scene.truths), PLAN_STEPS), np.pi / 2)
        frozen = [find_waypoint_contacts(stacked, present[:, 1:], plan, ahead) for plan in plans]
        ours[f"exact contact with a frozen heading, {objects}"] = (np.stack(frozen, axis=1), f"way0_{objects}")
    compare_equal(comparison, exact, ours)


def _keep_objects(truths: tuple[SampleTruth, ...], present: Bools) -> list[SampleTruth]:
    """The samples with only the objects that are in a set."""
    bounds = np.cumsum([0, *(len(truth.instances) for truth in truths)])
    return [
        replace(truth, annotated=present[start:stop]) for truth, start, stop in zip(truths, bounds[:-1], bounds[1:])
    ]


def _recorded_boxes(stacked: StackedTruths) -> Floats:
    """(S, 30, 5) the recorded ego with its own heading at each instant."""
    poses = stacked.ego_future
    now = np.broadcast_to([0.0, 0.0, np.pi / 2], (len(poses), 1, 3))
    before = np.concatenate([now, poses[:, :-1]], axis=1)
    return interpolate_footprints(before, poses).reshape(len(poses), _INSTANTS, 5)
