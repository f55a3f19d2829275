"""`challenger-bench verify physics`: the motion model against golden trajectories and degenerate candidates."""

from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.dynamics.bicycle import MotionModel, SimulatedMotion, VehicleState, compute_rear_axle, simulate
from benchmark.dynamics.reference_path import WAYPOINTS, build_reference_path
from benchmark.geometry import Bools, Floats, to_global
from benchmark.machine.storage import content_seed
from benchmark.report.words import pluralise
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder, GoldenSet
from generation.extensions.golden_sets.built_in import BUILT_IN

STEPS: Final = 80
"""Frames that golden sets simulate."""
NUDGE_M: Final = 1e-6
"""The specification calls a candidate well-conditioned if it moves less than `STEADY_M` when its waypoints move so."""
STEADY_M: Final = 1e-3
NUDGES: Final = 8
FILE: Final = "physics_degenerate.npz"
COMMON: Final = "common_center_x_y_heading_width_length_height"


def compare_degenerate(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare the degenerate candidates of a set, where it has some; finite where the golden ones are.

    They carry no measure of how well-conditioned they are: waypoints are nudged at random, and positions are compared
    for as many frames as they stay put.
    """
    if not folder.has(FILE):
        return
    stored = folder.arrays(FILE)
    common = stored.floats(COMMON, 6)
    pose, length_m = compute_rear_axle(common[:3], common[4]), float(common[4])
    names = sorted(name.removesuffix("/waypoints_local") for name in stored.names if name.endswith("/waypoints_local"))
    quantity = "degenerate candidates: centre position (m)"
    comparison.verdicts("degenerate candidates that are not finite", np.zeros(0, np.bool_))
    cut = []
    for name in names:
        golden = stored.floats(f"{name}/center_pose", STEPS + 1, 3)
        state = VehicleState(pose, float(stored.floats(f"{name}/speed_per_step")))
        centers = _simulate_nudged(stored.floats(f"{name}/waypoints_local", WAYPOINTS, 3), state, length_m)
        comparison.verdicts("degenerate candidates that are not finite", ~np.isfinite(centers[:1]).all(axis=(1, 2)))
        steady = np.maximum.accumulate(np.abs(centers[1:] - centers[0]).max(axis=(0, 2))) < STEADY_M
        frames = int(np.count_nonzero(steady))
        if frames < len(golden):
            cut.append(f"{name} after frame {frames - 1}")
        comparison.numbers(quantity, centers[0, :frames], golden[:frames, :2], where=name)
    if cut:
        comparison.note(quantity, f"not compared where a micrometre decides: {', '.join(cut)}")


def _simulate_nudged(waypoints: Floats, state: VehicleState, length_m: float) -> Floats:
    """Centres (1 + `NUDGES`, 81, 2): of the candidate, then of its nudged copies."""
    rng = np.random.default_rng(content_seed("nudged waypoints", waypoints.tolist()))
    nudges = NUDGE_M * rng.choice([-1.0, 1.0], (NUDGES, *waypoints.shape))
    all_of_them = np.concatenate([waypoints[None], waypoints + nudges])
    motion = simulate(all_of_them, state, length_m, steps=STEPS, model=MotionModel.reference())
    return motion.center[..., :2]


SOON_FRAMES: Final = 13
"""Frames over which the sets say how sensitive the others are."""
SOON_TOLERANCE_M: Final = 1e-3
"""Where a candidate moves less than this when its waypoints move by a micrometre, it must agree as well as this."""
SHORTEST_CHORD_M: Final = 1e-6
"""The direction of a shorter displacement is decided by signs of zero or by rounding."""


@dataclass(frozen=True, slots=True)
class _InitialStateGroup:
    """Candidates of one initial state, as the set has them."""

    members: NDArray[np.int64]
    state: VehicleState
    length_m: float


def _compare_candidates(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare `MotionModel.reference`."""
    stored = folder.arrays("physics.npz")
    waypoints = stored.floats("waypoints_local", None, WAYPOINTS, 3)
    groups = _build_groups(stored, len(waypoints))
    # Overflows become infinite, and then fail the comparison.
    with np.errstate(over="ignore", invalid="ignore"):
        motion = _simulate(waypoints, groups)
        _compare_motion(comparison, stored, motion)
        _compare_ill_conditioned(comparison, stored, motion)
        _compare_paths(comparison, stored, waypoints, groups)
        _compare_broken_candidates(comparison, waypoints, groups[0])
        compare_degenerate(comparison, folder)


def _build_groups(stored: GoldenArrays, candidates: int) -> list[_InitialStateGroup]:
    """The initial states that have candidates."""
    columns = stored.columns("group_columns", "rear_x", "rear_y", "rear_heading", "speed_per_step", "length")
    rows, number = stored.floats("groups", None, None), stored.integers("group", candidates)
    groups = []
    for index in np.unique(number):
        x, y, heading, speed, length = rows[index, columns]
        if not length > 0.0:
            raise ValueError(f"group {index} has length {length:g} m")
        state = VehicleState(np.array([x, y, heading]), float(speed))
        groups.append(_InitialStateGroup(np.flatnonzero(number == index), state, float(length)))
    return groups


def _simulate(waypoints: Floats, groups: list[_InitialStateGroup]) -> SimulatedMotion:
    """All candidates, each from the state of its group."""
    order = np.argsort(np.concatenate([group.members for group in groups]))
    parts = [
        simulate(waypoints[group.members], group.state, group.length_m, steps=STEPS, model=MotionModel.reference())
        for group in groups
    ]
    names = [item.name for item in fields(SimulatedMotion)]
    return SimulatedMotion(**{name: np.concatenate([getattr(part, name) for part in parts])[order] for name in names})


def _compare_motion(comparison: Comparison, stored: GoldenArrays, motion: SimulatedMotion) -> None:
    """The well-conditioned candidates over all frames."""
    count = len(motion.center)
    good = stored.verdicts("well_conditioned", count)
    center = stored.floats("center_pose", count, STEPS + 1, 3)
    at = stored.columns("state_columns", "x_rear", "y_rear", "heading", "velocity_x", "accel_x", "steering_angle")
    state = stored.floats("state", count, STEPS + 1, None)[..., at]
    at = stored.columns("command_columns", "acceleration", "steering_rate")
    commands = stored.floats("commands", count, STEPS, None)[..., at]
    numbers = {
        "centre position (m)": (motion.center[..., :2], center[..., :2]),
        "centre heading (rad)": (motion.center[..., 2], center[..., 2]),
        "rear axle position (m)": (motion.states[..., :2], state[..., :2]),
        "rear axle heading (rad)": (motion.states[..., 2], state[..., 2]),
        "speed (m/frame)": (motion.states[..., 3], state[..., 3]),
        "acceleration (m/frame^2)": (motion.states[..., 4], state[..., 4]),
        "steering angle (rad)": (motion.states[..., 5], state[..., 5]),
        "commanded acceleration (m/frame^2)": (motion.commands[..., 0], commands[..., 0]),
        "commanded steering rate (rad/frame)": (motion.commands[..., 1], commands[..., 1]),
    }
    for name, (ours, golden) in numbers.items():
        comparison.numbers(name, ours[good], golden[good], angle="heading" in name)
    comparison.note(
        "centre position (m)", f"{np.count_nonzero(good)} of {pluralise(count, 'candidate')} are well-conditioned"
    )


def _compare_ill_conditioned(comparison: Comparison, stored: GoldenArrays, motion: SimulatedMotion) -> None:
    """The others: as far as their sensitivity allows, and finite in any case."""
    count = len(motion.center)
    other = ~stored.verdicts("well_conditioned", count)
    if not other.any():
        return
    center = stored.floats("center_pose", count, STEPS + 1, 3)
    soon = other & (stored.floats("sensitivity_13_steps_m", count) < SOON_TOLERANCE_M)
    frames = slice(0, SOON_FRAMES + 1)
    comparison.verdicts("other candidates that are not finite", ~np.isfinite(motion.center[other]).all(axis=(1, 2)))
    if soon.any():
        quantity = f"centre position of others, first {SOON_FRAMES} frames (m)"
        comparison.numbers(quantity, motion.center[soon, frames, :2], center[soon, frames, :2])
        comparison.note(quantity, pluralise(int(np.count_nonzero(soon)), "candidate"))
    free = other & ~soon
    if free.any():
        error = np.abs(motion.center[free, frames, :2] - center[free, frames, :2]).max(axis=(1, 2))
        comparison.note(
            "other candidates that are not finite",
            f"nothing more is asked of {np.count_nonzero(free)} whose golden result hangs on the last bit; "
            f"{np.count_nonzero(error < SOON_TOLERANCE_M)} of them agree",
        )


def _compare_paths(
    comparison: Comparison, stored: GoldenArrays, waypoints: Floats, groups: list[_InitialStateGroup]
) -> None:
    """Reference poses of all candidates, and the profiles fitted to those that are well-conditioned."""
    count = len(waypoints)
    good = stored.verdicts("well_conditioned", count)
    path = build_reference_path(waypoints[..., :2], dt=1.0, frames_per_waypoint=5, smooth=False)
    speed = stored.floats("velocity_profile", count, STEPS)
    curvature = stored.floats("curvature_profile", count, STEPS)
    comparison.numbers("speed profile (m/frame)", path.speed.T[good], speed[good])
    comparison.numbers("curvature profile (rad/m)", path.curvature.T[good], curvature[good])
    local = stored.floats("reference_local", count, STEPS + 1, 3)
    distinct = _has_direction(local)
    position, heading = path.position.transpose(2, 0, 1), path.heading.T
    comparison.numbers("reference position (m)", position, local[..., :2])
    placed = stored.floats("reference_global", count, STEPS + 1, 3)
    for group in groups:
        global_position = to_global(position[group.members], group.state.pose)
        comparison.numbers("reference position, global (m)", global_position, placed[group.members][..., :2])
    if distinct.any():
        quantity = "reference heading (rad)"
        comparison.numbers(quantity, heading[distinct], local[distinct][:, 2], angle=True)
        left_out = np.count_nonzero(~distinct)
        if left_out:
            comparison.note(quantity, f"{left_out} poses without displacement left out: signs of zero decide there")


def _has_direction(poses: Floats) -> Bools:
    """(B, F + 1) whether the displacement that a pose's heading is taken from is long enough to have one."""
    chord = np.linalg.norm(poses[:, 2:, :2] - poses[:, :-2, :2], axis=-1) >= SHORTEST_CHORD_M
    return np.concatenate([chord[:, :1], chord, chord[:, -1:]], axis=1)


def _compare_broken_candidates(comparison: Comparison, waypoints: Floats, group: _InitialStateGroup) -> None:
    """A candidate with NaN and one with infinity are dropped; their neighbours do not change by a bit."""
    clean = np.resize(waypoints[group.members], (max(3, len(group.members)), WAYPOINTS, 3))
    broken = clean.copy()
    broken[0, 7, 0], broken[1, 3, 1] = np.nan, np.inf
    model = MotionModel.reference()
    alone = simulate(clean, group.state, group.length_m, steps=STEPS, model=model)
    beside = simulate(broken, group.state, group.length_m, steps=STEPS, model=model)
    comparison.verdicts("candidates with NaN or infinity that are kept", beside.finite[:2])
    quantity = "neighbours of NaN and infinity (m)"
    comparison.numbers(quantity, beside.center[2:][alone.finite[2:]], alone.center[2:][alone.finite[2:]])


GOLDEN: Final = GoldenSet(
    name="physics",
    files=("physics.npz",),
    compare=(_compare_candidates,),
    quantities={
        f"centre position of others, first {SOON_FRAMES} frames (m)": SOON_TOLERANCE_M,
        "neighbours of NaN and infinity (m)": 0.0,
        # Metres, radians and the units made of them and frames, for well-conditioned candidates in double precision.
        "*": 1e-6,
    },
    built_in=BUILT_IN / "physics",
)
