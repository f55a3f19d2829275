"""`challenger-bench verify results`: planners' result files; without ``--golden`` every format, from made-up plans."""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from adapters.result_files.contract import FileFrame
from adapters.result_files.frames import ego_waypoints, lidar_waypoints
from adapters.result_files.importing import ImportedPlans, import_results
from adapters.result_files.recognition import recognise
from adapters.result_files.samples import RecordedSamples
from adapters.result_files.synthetic import PRECISION_M, SINGLE_M, make_synthetic_plans, make_synthetic_samples
from adapters.result_files.writing.formats import WRITERS
from adapters.result_files.writing.pickles import PlansToWrite
from benchmark.constants import PLAN_STEPS
from benchmark.errors import InputError
from benchmark.extensions.golden_sets.protocols.golden_set import read_truths
from benchmark.geometry import Floats
from benchmark.protocols import PROTOCOLS
from benchmark.truth import SampleTruth
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder, GoldenSet


def compare_synthetic(comparison: Comparison) -> None:
    """Write the made-up plans in every format and read them back."""
    samples = make_synthetic_samples()
    dumped = PlansToWrite(samples, tuple(dict.fromkeys(samples.scenes)), make_synthetic_plans(samples), PLAN_STEPS)
    with tempfile.TemporaryDirectory() as folder:
        for name, write in WRITERS.items():
            imported, at = import_results([recognise(write(Path(folder) / name, dumped))], samples), comparison.at(name)
            file_plans = imported.found
            expected = np.array([dumped.waypoints(row, FileFrame.LIDAR) for row in file_plans.rows.tolist()])
            at.verdicts("formats", imported.format.name != name)
            at.verdicts("samples", len(file_plans.rows) != len(dumped.plans))
            at.numbers(f"{name} (m)", lidar_waypoints(file_plans, samples), expected, PRECISION_M.get(name, SINGLE_M))


FACTS, MANIFEST, PROTOCOLS_SET = "facts.npz", "manifest.json", "protocols"
_REFUSALS: Final = "refusals by category"


@dataclass(frozen=True, slots=True)
class _KnownSamples:
    """Samples for an importer, (S,) numbers in their scenes, and truths from the set ``protocols`` beside this one."""

    samples: RecordedSamples
    index_in_scene: NDArray[np.int64]
    truths: dict[str, list[SampleTruth]]


def _compare_files(comparison: Comparison, folder: GoldenFolder) -> None:
    """Read every file and compare formats, samples, plans, verdicts and refusals."""
    stored = folder.arrays(FACTS)
    samples = _samples(folder, stored)
    index = stored.integers("index_in_scene", len(samples.tokens))
    known = _KnownSamples(samples, index, _truths(folder, samples, index))
    comparison.same("commands of samples", samples.commands, stored.integers("command", len(samples.tokens)))
    files = folder.facts(MANIFEST)["files"]
    if not files:
        raise ValueError(f"{MANIFEST} lists no files")
    for entry in files:
        path = _resolve_inside(folder, entry["path"])
        started, accepted, at = time.perf_counter(), entry["outcome"] == "accept", comparison.at(entry["name"])
        try:
            imported = import_results([recognise(path)], samples)
        except InputError as refusal:
            _compare_refusal(at, entry, refusal, time.perf_counter() - started)
            continue
        if accepted:
            at.verdicts("files accepted", False)
            _compare_plans(at, entry, imported, known, folder.arrays(str(entry["expected"])))
        else:
            at.verdicts(_REFUSALS, True, where=f"{entry['name']}, which was accepted")
    if absent := sorted(set(samples.scenes) - set(known.truths)):
        says = f"no verdicts on {', '.join(absent)}: their objects are in a set protocols beside this one"
        comparison.note("commands of samples", says)


def _samples(folder: GoldenFolder, stored: GoldenArrays) -> RecordedSamples:
    tokens = stored.texts("token")
    count = len(tokens)
    mount = [*stored.floats("lidar_to_ego_translation", 3)[:2], float(stored.floats("lidar_to_ego_yaw"))]
    return RecordedSamples(
        name=f"the set {folder.path.name}",
        tokens=tuple(tokens),
        scenes=tuple(stored.texts("scene", count)),
        timestamps_us=stored.integers("timestamp", count),
        ego_pose=stored.floats("ego_pose", count, 3),
        lidar_in_ego=np.tile(mount, (count, 1)),
        future=stored.floats("ego_future_lidar", count, PLAN_STEPS, 3)[..., :2],
        valid=stored.verdicts("ego_future_valid", count, PLAN_STEPS),
        by_time=stored.integers("order_infos_timestamp", None),
        by_table=stored.integers("order_infos_scene", None),
    )


def _truths(folder: GoldenFolder, samples: RecordedSamples, index: NDArray[np.int64]) -> dict[str, list[SampleTruth]]:
    truths = {}
    for scene in sorted(set(samples.scenes)):
        path = folder.path.resolve().parent / PROTOCOLS_SET / f"{scene}.npz"
        if path.is_file():
            stored = GoldenArrays.read(path)
            count = len(stored.floats("ego_fut", None, PLAN_STEPS, 3))
            if count > index[np.array(samples.scenes) == scene].max():
                truths[scene] = read_truths(stored, count)
    return truths


def _resolve_inside(folder: GoldenFolder, name: str) -> Path:
    path = folder.path / name
    if not path.resolve().is_relative_to(folder.path.resolve()):
        raise ValueError(f"{MANIFEST} names {name}, which leaves the set")
    return path


def _compare_refusal(comparison: Comparison, entry: dict[str, Any], refusal: InputError, seconds: float) -> None:
    category = getattr(refusal, "category", "none")
    where = f"{entry['name']}, refused as {category}: {refusal}"
    if entry["outcome"] == "accept":
        comparison.verdicts("files accepted", True, where=where)
        return
    comparison.verdicts(_REFUSALS, category not in (entry["category"], *entry.get("also_ok", ())), where=where)
    comparison.verdicts("refusals in one line", "\n" in str(refusal))
    comparison.errors("longest refusal (s)", seconds)


def _compare_plans(
    comparison: Comparison, entry: dict[str, Any], imported: ImportedPlans, known: _KnownSamples, expected: GoldenArrays
) -> None:
    file_plans, samples = imported.found, known.samples
    tokens, golden_tokens = [samples.tokens[row] for row in file_plans.rows.tolist()], expected.texts("tokens")
    facts: dict[str, tuple[Any, Any]] = {
        "formats": (imported.format.name, entry["format"]),
        "frames": (file_plans.frame.value, entry["frame"]),
        "numbers of plans": (len(file_plans.rows), entry["plans"]),
        "numbers of waypoints": (file_plans.waypoints.shape[1], entry["waypoints"]),
        "orders": (file_plans.order, entry["order"]),
        "skipped samples": (set(file_plans.skipped), set(entry["skipped"])),
        "duplicates dropped": (file_plans.duplicates, entry.get("duplicates_dropped", 0)),
        "mirrored": (file_plans.mirrored, entry.get("mirrored_in_file", file_plans.mirrored)),
        "tokens and their order": (tokens, golden_tokens),
    }
    for quantity, (ours, golden) in facts.items():
        comparison.verdicts(quantity, ours != golden)
    if tokens != golden_tokens:
        return
    count = len(file_plans.rows)
    comparison.same("complete samples", samples.complete[file_plans.rows], expected.verdicts("complete", count))
    tie = expected.verdicts("heading_tie", count, PLAN_STEPS)[..., None]
    lidar, ego = lidar_waypoints(file_plans, samples)[:, :PLAN_STEPS], ego_waypoints(file_plans, samples)
    golden_ego = expected.floats("plan_ego", count, PLAN_STEPS, 2)
    plans = {"plan": file_plans.waypoints, "plan_lidar": lidar, "plan_ego": np.where(tie, golden_ego, ego)}
    for name, waypoints in plans.items():
        allowed = entry["compare"][name]
        allowed = float(allowed["tolerance"] if isinstance(allowed, dict) else allowed)
        comparison.numbers(f"{name} (m), to {allowed:g}", waypoints, expected.floats(name, *waypoints.shape), allowed)
    for scene, truths in known.truths.items():
        places = np.flatnonzero(np.array([samples.scenes[row] == scene for row in file_plans.rows.tolist()]))
        if len(places):
            chosen = [truths[index] for index in known.index_in_scene[file_plans.rows[places]].tolist()]
            at = comparison.at(f"{entry['name']}, {scene}")
            _compare_verdicts(at, lidar[places], chosen, expected, places)


def _compare_verdicts(
    comparison: Comparison, plans: Floats, truths: list[SampleTruth], expected: GoldenArrays, places: NDArray[np.int64]
) -> None:
    """Verdicts of three protocols on the plans of one scene; two of them say nothing of incomplete samples."""
    complete = np.array([truth.complete for truth in truths])
    uniad, vad, sparse = (PROTOCOLS[name].evaluate(truths, plans) for name in ("uniad", "vad", "sparsedrive"))
    of_vad, everywhere = PROTOCOLS["vad"].sample_values(vad), np.ones_like(complete)
    equal = {
        "uniad obj_box_col": (uniad.collision, "uniad_obj_box_col", everywhere),
        "uniad obj_col": (uniad.step("obj_col"), "uniad_obj_col", everywhere),
        "vad obj_box_col": (of_vad["collision"], "vad_obj_box_col", complete),
        "sparsedrive obj_box_col": (sparse.collision, "sd_obj_box_col", complete),
    }
    for quantity, (ours, name, of) in equal.items():
        comparison.same(quantity, ours, expected.floats(name, None, ours.shape[1])[places], of)
    close = {
        "uniad L2 (m)": (uniad.l2, "uniad_L2", everywhere),
        "vad L2 (m)": (of_vad["l2"], "vad_L2", complete),
        "sparsedrive L2 (m)": (sparse.l2, "sd_L2", complete),
    }
    for quantity, (ours, name, of) in close.items():
        comparison.numbers(quantity, ours[of], expected.floats(name, None, ours.shape[1])[places][of])


GOLDEN: Final = GoldenSet(
    name="results",
    usual="result_files",
    files=(FACTS, MANIFEST),
    compare=(_compare_files,),
    quantities={"longest refusal (s)": 10.0, "* L2 (m)": 1e-4},
    made_here=compare_synthetic,
)
