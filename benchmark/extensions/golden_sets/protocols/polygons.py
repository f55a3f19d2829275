"""The geometry of ``exact`` against verdicts of exact polygons: all objects, and those that each protocol counts."""

from dataclasses import replace
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.golden_sets.protocols.golden_set import GoldenScene
from benchmark.geometry import Bools, Floats
from benchmark.protocols import PROTOCOLS, Outcomes
from benchmark.protocols.exact import INSTANTS_PER_STEP, contacts, ego_boxes, footprints_between
from benchmark.protocols.sparsedrive import waypoint_contacts
from benchmark.protocols.stacked import StackedTruths, stack
from benchmark.truth import SampleTruth
from benchmark.verification.checks import Comparison

HEADING_RAD: Final = 1e-6
"""Allowed error of a heading: the golden ones are single precision."""
_INSTANTS: Final = PLAN_STEPS * INSTANTS_PER_STEP
_FROZEN: Final = ("all", "uniad", "vad")
"""Object sets for which the verdicts with a frozen heading are stored too."""


def compare_polygons(comparison: Comparison, scene: GoldenScene, judged: list[Outcomes]) -> None:
    """Compare contacts at the waypoints and every 0.1 s, of plans and of the recorded ego, and headings of plans.

    Args:
        comparison: Where the errors go.
        scene: A scene that has exact verdicts.
        judged: What ``exact`` says about each of the P plans.

    Raises:
        InputError: If an array of verdicts is absent, damaged or of the wrong shape.
    """
    assert scene.exact is not None
    exact, where = scene.exact, scene.name
    stacked, shape = stack(scene.truths), scene.plans.shape[:3]
    steps = exact.verdicts("cont_all", *shape[:2], _INSTANTS).reshape(*shape, INSTANTS_PER_STEP).any(axis=-1)
    ours = np.stack([outcomes.collision for outcomes in judged], axis=1)
    comparison.verdicts("exact collision", ours != steps, where=where)
    for objects, present in object_sets(stacked).items():
        _compare_set(comparison, scene, stacked, objects, present)
    heading = exact.floats("heading", *shape[:2], PLAN_STEPS + 1)[..., 1:]
    ours = np.stack([PROTOCOLS["exact"].headings(scene.plans[:, plan]) for plan in range(shape[1])], axis=1)
    comparison.numbers("exact heading (rad)", ours, heading, HEADING_RAD, angle=True, where=where)


def object_sets(truths: StackedTruths) -> dict[str, Bools]:
    """Which objects are there now and at the six steps, in the eyes of each protocol.

    Args:
        truths: S samples with M objects.

    Returns:
        (M, 7) verdicts for ``all``, ``uniad``, ``vad`` and ``sd``.
    """
    counted = {name: PROTOCOLS[name].counted_objects(truths) for name in ("uniad", "vad", "sparsedrive")}
    now = truths.annotated[:, 0]
    before = {
        "uniad": now & counted["uniad"].any(axis=1),
        "vad": now & counted["vad"].any(axis=1),
        "sparsedrive": now & truths.has_lidar_points[:, 0],
    }
    seen = {name: np.concatenate([before[name][:, None], counted[name]], axis=1) for name in counted}
    return {"all": truths.annotated, "uniad": seen["uniad"], "vad": seen["vad"], "sd": seen["sparsedrive"]}


def _compare_set(
    comparison: Comparison, scene: GoldenScene, stacked: StackedTruths, objects: str, present: Bools
) -> None:
    exact, where = scene.exact, scene.name
    assert exact is not None
    samples, plans = scene.plans.shape[:2]
    truths = _reduced(scene.truths, present)
    found = np.stack([contacts(ego_boxes(scene.plans[:, plan]), truths)[0] for plan in range(plans)], axis=1)
    golden = exact.verdicts(f"cont_{objects}", samples, plans, _INSTANTS)
    comparison.verdicts("exact contact every 0.1 s, " + objects, found != golden, where=where)
    at_waypoints = found[..., INSTANTS_PER_STEP - 1 :: INSTANTS_PER_STEP]
    golden = exact.verdicts(f"way_{objects}", samples, plans, PLAN_STEPS)
    comparison.verdicts("exact contact at waypoints, " + objects, at_waypoints != golden, where=where)
    recorded, _ = contacts(_recorded_boxes(stacked), truths)
    golden = exact.verdicts(f"gt_way_{objects}", samples, PLAN_STEPS)
    ours = recorded[:, INSTANTS_PER_STEP - 1 :: INSTANTS_PER_STEP] & stacked.ego_future_valid
    comparison.verdicts("exact contact of the recorded ego, " + objects, ours != golden, where=where)
    if objects == "all":
        golden = exact.verdicts("gt_cont_all", samples, _INSTANTS)
        valid = np.repeat(stacked.ego_future_valid, INSTANTS_PER_STEP, axis=1)
        comparison.verdicts("exact contact of the recorded ego every 0.1 s", (recorded & valid) != golden, where=where)
    if objects in _FROZEN:
        ahead = np.full((samples, PLAN_STEPS), np.pi / 2)
        frozen = [waypoint_contacts(stacked, present[:, 1:], scene.plans[:, plan], ahead) for plan in range(plans)]
        golden = exact.verdicts(f"way0_{objects}", samples, plans, PLAN_STEPS)
        wrong = np.stack(frozen, axis=1) != golden
        comparison.verdicts("exact contact with a frozen heading, " + objects, wrong, where=where)


def _reduced(truths: tuple[SampleTruth, ...], present: Bools) -> list[SampleTruth]:
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
    return footprints_between(before, poses).reshape(len(poses), _INSTANTS, 5)
