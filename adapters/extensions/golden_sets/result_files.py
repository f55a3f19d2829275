"""`challenger-bench verify results`: result files of planners' repositories against what must come out of them."""

import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.extensions.golden_sets.result_file_set import GoldenFile, GoldenResults, read_golden_results
from adapters.extensions.golden_sets.result_files_made_here import verify_made_here
from adapters.result_files.frames import ego_waypoints, lidar_waypoints
from adapters.result_files.importing import ImportedPlans, import_results
from adapters.result_files.recognition import recognise
from benchmark.constants import PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.protocols import PROTOCOLS
from benchmark.truth import SampleTruth
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.golden import GoldenArrays

L2_M: Final = 1e-4
SECONDS: Final = 10.0
"""What a refusal may take."""
_REFUSALS: Final = "refusals by category"


def verify_results(golden: Path | None = None) -> list[Check]:
    """Read every file of a set and compare formats, samples, plans, verdicts and refusals.

    Args:
        golden: Folder of the set; by default files of every format are written here and read back.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    if golden is None:
        return verify_made_here()
    stored = read_golden_results(golden)
    truths = stored.truths()
    comparison = Comparison()
    comparison.verdicts("commands of samples", stored.samples.commands != stored.commands)
    for file in stored.files:
        started = time.perf_counter()
        try:
            found = import_results([recognise(file.path)], stored.samples)
        except InputError as refusal:
            _compare_refusal(comparison, file, refusal, time.perf_counter() - started)
            continue
        if file.accepted:
            comparison.verdicts("files accepted", np.array([False]), where=file.name)
            _compare_plans(comparison, file, found, stored, truths)
        else:
            comparison.verdicts(_REFUSALS, np.array([True]), where=f"{file.name}, which was accepted")
    absent = sorted(set(stored.samples.scenes) - set(truths))
    if absent:
        says = f"no verdicts on {', '.join(absent)}: their objects are in a set protocols beside this one"
        comparison.note("commands of samples", says)
    return comparison.checks()


def _compare_refusal(comparison: Comparison, file: GoldenFile, refusal: InputError, seconds: float) -> None:
    category = getattr(refusal, "category", "none")
    if file.accepted:
        comparison.verdicts("files accepted", np.array([True]), where=f"{file.name}, refused as {category}: {refusal}")
        return
    wrong = category not in file.categories
    comparison.verdicts(_REFUSALS, np.array([wrong]), where=f"{file.name}, refused as {category}: {refusal}")
    comparison.verdicts("refusals in one line", np.array(["\n" in str(refusal)]), where=file.name)
    comparison.numbers("longest refusal (s)", np.array([seconds]), np.zeros(1), SECONDS, where=file.name)


def _compare_plans(
    comparison: Comparison,
    file: GoldenFile,
    imported: ImportedPlans,
    stored: GoldenResults,
    truths: dict[str, list[SampleTruth]],
) -> None:
    found, samples, said = imported.found, stored.samples, file.stored
    expected = GoldenArrays.read(stored.folder / str(said["expected"]))
    facts: dict[str, tuple[Any, Any]] = {
        "formats": (imported.format.name, said["format"]),
        "frames": (found.frame.value, said["frame"]),
        "numbers of plans": (len(found.rows), said["plans"]),
        "numbers of waypoints": (found.waypoints.shape[1], said["waypoints"]),
        "orders": (found.order, said["order"]),
        "skipped samples": (set(found.skipped), set(said["skipped"])),
        "duplicates dropped": (found.duplicates, said.get("duplicates_dropped", 0)),
        "mirrored": (found.mirrored, said.get("mirrored_in_file", found.mirrored)),
        "tokens and their order": ([samples.tokens[row] for row in found.rows.tolist()], expected.texts("tokens")),
    }
    for quantity, (ours, golden) in facts.items():
        comparison.verdicts(quantity, np.array([ours != golden]), where=file.name)
    if facts["tokens and their order"][0] != facts["tokens and their order"][1]:
        return
    count = len(found.rows)
    comparison.verdicts(
        "complete samples", samples.complete[found.rows] != expected.verdicts("complete", count), where=file.name
    )
    tie = expected.verdicts("heading_tie", count, PLAN_STEPS)[..., None]
    lidar = lidar_waypoints(found, samples)[:, :PLAN_STEPS]
    ego = ego_waypoints(found, samples)
    golden_ego = expected.floats("plan_ego", count, PLAN_STEPS, 2)
    _numbers(comparison, file, "plan", found.waypoints, expected.floats("plan", *found.waypoints.shape))
    _numbers(comparison, file, "plan_lidar", lidar, expected.floats("plan_lidar", *lidar.shape))
    _numbers(comparison, file, "plan_ego", np.where(tie, golden_ego, ego), golden_ego)
    for scene, of_scene in truths.items():
        here = np.flatnonzero(np.array([samples.scenes[row] == scene for row in found.rows.tolist()]))
        if len(here):
            chosen = [of_scene[index] for index in stored.index_in_scene[found.rows[here]].tolist()]
            _compare_verdicts(comparison, f"{file.name}, {scene}", lidar[here], chosen, expected, here)


def _numbers(comparison: Comparison, file: GoldenFile, array: str, ours: Floats, golden: Floats) -> None:
    allowed = file.tolerance(array)
    comparison.numbers(f"{array} (m), to {allowed:g}", ours, golden, allowed, where=file.name)


def _compare_verdicts(
    comparison: Comparison,
    where: str,
    plans: Floats,
    truths: list[SampleTruth],
    expected: GoldenArrays,
    here: Any,
) -> None:
    """Verdicts of three protocols on the plans of one scene; two of them say nothing of incomplete samples."""
    complete = np.array([truth.complete for truth in truths])
    uniad, vad, sparse = (PROTOCOLS[name].evaluate(truths, plans) for name in ("uniad", "vad", "sparsedrive"))
    of_vad = PROTOCOLS["vad"].sample_values(vad)

    def golden(name: str, last: int = PLAN_STEPS) -> Floats:
        return np.asarray(expected.floats(name, None, last)[here])

    flags = {
        "uniad obj_box_col": uniad.collision != golden("uniad_obj_box_col"),
        "uniad obj_col": uniad.step("obj_col") != golden("uniad_obj_col"),
        "vad obj_box_col": (of_vad["collision"] != golden("vad_obj_box_col", 3))[complete],
        "sparsedrive obj_box_col": (sparse.collision != golden("sd_obj_box_col"))[complete],
    }
    for quantity, wrong in flags.items():
        comparison.verdicts(quantity, wrong, where=where)
    comparison.numbers("uniad L2 (m)", uniad.l2, golden("uniad_L2"), L2_M, where=where)
    comparison.numbers("vad L2 (m)", of_vad["l2"][complete], golden("vad_L2", 3)[complete], L2_M, where=where)
    comparison.numbers("sparsedrive L2 (m)", sparse.l2[complete], golden("sd_L2")[complete], L2_M, where=where)
