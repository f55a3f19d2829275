"""Contacts and commands, one by one."""

from dataclasses import replace

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.extensions.neuroncap.actors import Actor
from benchmark.extensions.neuroncap.car import Car
from benchmark.extensions.neuroncap.command import command_at
from benchmark.extensions.neuroncap.contact import EgoMoment, touched
from benchmark.records.neuroncap_switches import CODE
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays, GoldenFolder


def compare_contacts(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare all checks, with the published box and with a longer one that lies further ahead."""
    stored = folder.arrays("contact.npz")
    checks = len(stored.texts("kind"))
    poses, speed = stored.floats("ego", checks, 4, 4), stored.floats("speed", checks)
    time, actors = stored.integers("time", checks), _actors_of_checks(stored, checks)
    hit, other_hit = stored.integers("hit", checks), stored.integers("hit_alt", checks)
    iou = stored.floats("iou", checks)
    ego_velocity, actor_velocity = stored.floats("ego_velocity", checks, 3), stored.floats("actor_velocity", checks, 3)
    car = Car.of(CODE)
    other = replace(car, box_ahead_m=EGO_CENTER_FROM_REAR_AXLE_M, length_m=float(np.float32(EGO_LENGTH_M)))
    for number in range(checks):
        at = comparison.at(f"contact.npz, check {number}")
        ego = EgoMoment(int(time[number]), poses[number], float(speed[number]))
        found = touched(ego, actors[number], car, CODE)
        again = touched(ego, actors[number], other, CODE)
        for name, contact, golden in (("", found, hit), (" with the other box", again, other_hit)):
            index = -1 if contact is None else contact.index
            at.verdicts(f"contact{name}: who is touched", bool(index != golden[number]))
        if found is not None and found.index == hit[number]:
            at.numbers("contact: IoU", found.iou, iou[number])
            at.numbers("contact: velocity of the ego (m/s)", found.ego_velocity, ego_velocity[number])
            at.numbers("contact: velocity of the actor (m/s)", found.actor_velocity, actor_velocity[number])


def _actors_of_checks(stored: GoldenArrays, checks: int) -> list[list[Actor]]:
    """Actors of each check, in order."""
    case = stored.integers("actor_case", None)
    kinds, sizes = stored.texts("actor_class", len(case)), stored.floats("actor_dims", len(case), 3)
    owner = stored.integers("pose_actor", None)
    times, poses = stored.integers("pose_time", len(owner)), stored.floats("pose", len(owner), 4, 4)
    found: list[list[Actor]] = [[] for _ in range(checks)]
    for number, check in enumerate(case.tolist()):
        own = owner == number
        found[check].append(Actor(str(number), kinds[number], sizes[number], times[own], poses[own]))
    return found


def compare_commands(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare all commands."""
    stored = folder.arrays("command.npz")
    which = stored.integers("path", None)
    poses, speed = stored.floats("pose", len(which), 4, 4), stored.floats("speed", len(which))
    paths = {number: stored.floats(f"polyline_{number}", None, 3) for number in np.unique(which).tolist()}
    ours = [command_at(pose, float(v), paths[line], CODE) for pose, v, line in zip(poses, speed, which.tolist())]
    comparison.at("command.npz").same("command", ours, stored.integers("command", len(which)))
