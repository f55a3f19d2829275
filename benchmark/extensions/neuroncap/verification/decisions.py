"""Contacts and commands, one by one."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.actors import Actor
from benchmark.extensions.neuroncap.car import Car
from benchmark.extensions.neuroncap.command import command_at
from benchmark.extensions.neuroncap.contact import EgoMoment, touched
from benchmark.extensions.neuroncap.verification.golden_set import TOLERANCE, NcapArrays
from benchmark.records.neuroncap_switches import CODE
from benchmark.verification.checks import Comparison

IOU_TOLERANCE: Final = 1e-6


def compare_contacts(comparison: Comparison, path: Path) -> None:
    """Compare all checks, with the published box and with a longer one that lies further ahead.

    Args:
        comparison: Takes the errors.
        path: ``contact.npz``.

    Raises:
        InputError: If the file cannot be used.
    """
    stored = NcapArrays.read(path)
    checks = len(stored.texts("kind"))
    poses, speed = stored.floats("ego", checks, 4, 4), stored.floats("speed", checks)
    time, actors = stored.integers("time", checks), _actors_of_checks(stored, checks)
    hit, other_hit = stored.integers("hit", checks), stored.integers("hit_alt", checks)
    iou = stored.floats("iou", checks)
    ego_velocity, actor_velocity = stored.floats("ego_velocity", checks, 3), stored.floats("actor_velocity", checks, 3)
    car = Car.of(CODE)
    other = replace(car, box_ahead_m=EGO_CENTER_FROM_REAR_AXLE_M, length_m=float(np.float32(EGO_LENGTH_M)))
    for number in range(checks):
        where = f"{path.name}, check {number}"
        ego = EgoMoment(int(time[number]), poses[number], float(speed[number]))
        found = touched(ego, actors[number], car, CODE)
        again = touched(ego, actors[number], other, CODE)
        for name, contact, golden in (("", found, hit), (" with the other box", again, other_hit)):
            index = -1 if contact is None else contact.index
            comparison.verdicts(f"contact{name}: who is touched", np.array([index != golden[number]]), where=where)
        if found is not None and found.index == hit[number]:
            shared = np.array([found.iou])
            comparison.numbers("contact: IoU", shared, iou[number : number + 1], IOU_TOLERANCE, where=where)
            for name, ours, theirs in (
                ("ego", found.ego_velocity, ego_velocity[number]),
                ("actor", found.actor_velocity, actor_velocity[number]),
            ):
                comparison.numbers(f"contact: velocity of the {name} (m/s)", ours, theirs, TOLERANCE, where=where)


def _actors_of_checks(stored: NcapArrays, checks: int) -> list[list[Actor]]:
    """Actors of each check, in order."""
    case = stored.integers("actor_case", None)
    kinds, sizes = stored.texts("actor_class", len(case)), stored.floats("actor_dims", len(case), 3)
    owner = stored.integers("pose_actor", None)
    times, poses = stored.integers("pose_time", len(owner)), stored.floats("pose", len(owner), 4, 4)
    found: list[list[Actor]] = [[] for _ in range(checks)]
    for number, check in enumerate(case.tolist()):
        own = owner == number
        if not 0 <= check < checks or not own.any() or (np.diff(times[own]) <= 0).any():
            raise InputError(
                f"{stored.path}: actor {number} has no check, no poses or stamps that do not rise; get it again"
            )
        found[check].append(Actor(str(number), kinds[number], sizes[number], times[own], poses[own]))
    return found


def compare_commands(comparison: Comparison, path: Path) -> None:
    """Compare all commands.

    Args:
        comparison: Takes the errors.
        path: ``command.npz``.

    Raises:
        InputError: If the file cannot be used.
    """
    stored = NcapArrays.read(path)
    which = stored.integers("path", None)
    poses, speed = stored.floats("pose", len(which), 4, 4), stored.floats("speed", len(which))
    golden = stored.integers("command", len(which))
    paths = {number: stored.floats(f"polyline_{number}", None, 3) for number in np.unique(which).tolist()}
    for number, line in paths.items():
        if len(line) < 2:
            raise InputError(f"{path}: polyline_{number} has fewer than two points; fetch or make the file again")
    ours = [command_at(pose, float(v), paths[line], CODE) for pose, v, line in zip(poses, speed, which.tolist())]
    comparison.verdicts("command", np.array(ours, np.int64) != golden, where=path.name)
