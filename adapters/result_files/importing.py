"""Import of result files: recognise, read, match with samples, check plausibility (`benchmark.untrusted`), convert."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from adapters.result_files.contract import FileFrame, FilePlans, ResultFormat, Rows, refuse
from adapters.result_files.frames import lidar_waypoints, plans_of
from adapters.result_files.recognition import RecognisedFile
from adapters.result_files.samples import RecordedSamples
from benchmark.constants import FARTHEST_WAYPOINT_M, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.planning import Plan
from benchmark.records.run_schema import SampleOrder
from benchmark.untrusted.files import RefusedFileError
from benchmark.untrusted.plan_plausibility import ComparedPlans, FrameName, Plausibility, measure_plausibility
from benchmark.untrusted.plan_verdicts import format_refusal

_TOO_FAR = "such plans are not scored; check which script wrote the file"


def require_plausible(
    path: Path, plans: Floats, rows: Rows, samples: RecordedSamples, *, as_is: bool = False
) -> Plausibility:
    """Refuse plans that fit far better in another unit, frame or origin; give what was measured.

    `plans` are (N, K, 2) positions of the lidar, x right, y forward. `as_is` lets all but impossible ones pass. The
    refusal has the category of the first test that fails, and what would fit.
    """
    complete = samples.complete[rows]
    plausibility = measure_plausibility(ComparedPlans(plans[complete, :PLAN_STEPS], samples.future[rows][complete]))
    if plausibility.misreading is not None and not as_is:
        raise RefusedFileError(plausibility.misreading.category, format_refusal(path, plausibility.misreading))
    far = np.abs(plans).max(axis=(1, 2), initial=0.0)
    if far.max(initial=0.0) > FARTHEST_WAYPOINT_M:
        token = samples.tokens[int(rows[far.argmax()])]
        what = f"the plan of sample {token} reaches {far.max():.3g} m, so its units or frame are wrong"
        refuse(path, "unit", what, _TOO_FAR)
    return plausibility


EVIDENCE_ORDER: Final[tuple[SampleOrder, ...]] = ("assumed", "consistent", "proven", "tokens")
"""How well the order of a file is shown, worst first."""


@dataclass(frozen=True, slots=True)
class ImportedPlans:
    """Plans of result files: `found` in the frame of the files, `plans` by token as protocols take them."""

    paths: tuple[Path, ...]
    format: ResultFormat
    found: FilePlans
    plans: dict[str, Plan]
    plausibility: Plausibility


def import_results(
    opened: Sequence[RecognisedFile],
    samples: RecordedSamples,
    scenes: Collection[str] | None = None,
    *,
    frame: FrameName | None = None,
    as_is: bool = False,
) -> ImportedPlans:
    """Plans of the result files of one run.

    Where only some `scenes` are evaluated, a file without tokens may be of them alone. `frame` overrides the format's;
    `as_is` takes plans unchanged. Files of different formats are an `InputError`; a damaged or hostile file, or plans
    that are impossible or of other samples, a `RefusedFileError`.
    """
    first = opened[0]
    for other in opened[1:]:
        if other.format is not first.format:
            raise InputError(
                f"{first.path} has the format {first.format.name} and {other.path} {other.format.name}; score them "
                "one by one"
            )
    if len(opened) > 1 and first.format.by_place:
        raise InputError(
            f"files of the format {first.format.name} name no samples, so each is the whole of what was evaluated; "
            "score them one by one, with --scenes if they cover only some scenes"
        )
    parts = [_read(file, samples, scenes) for file in opened]
    joined = _join_files(parts, opened, samples)
    if frame is not None:
        joined = replace(joined, frame=FileFrame(frame))
    plausibility = require_plausible(first.path, lidar_waypoints(joined, samples), joined.rows, samples, as_is=as_is)
    tokens = [samples.tokens[row] for row in joined.rows.tolist()]
    plans = dict(zip(tokens, plans_of(joined, samples), strict=True))
    return ImportedPlans(tuple(file.path for file in opened), first.format, joined, plans, plausibility)


def _read(opened: RecognisedFile, samples: RecordedSamples, scenes: Collection[str] | None) -> FilePlans:
    """Plans of a file; without tokens in the order of info files that it does not contradict, the better shown one."""
    if not opened.format.by_place:
        return opened.format.read(opened.path, opened.content, samples)
    candidates: list[FilePlans] = []
    refused: RefusedFileError | None = None
    for ordered in samples.possible_orders():
        try:
            candidates.append(_read_part(opened, ordered, scenes))
        except RefusedFileError as error:
            refused = refused or error
    if refused is not None and not candidates:
        raise refused
    best = max(candidates, key=lambda plans: EVIDENCE_ORDER.index(plans.order))
    if any(other.order == best.order and not np.array_equal(other.rows, best.rows) for other in candidates):
        return replace(best, order="assumed", shown_by=f"{best.shown_by}; another order of info files fits as well")
    return best


def _read_part(opened: RecognisedFile, samples: RecordedSamples, scenes: Collection[str] | None) -> FilePlans:
    """Plans of a file of the whole split, or of the chosen scenes where only their number fits."""
    content = opened.content
    if scenes is not None:
        entries = content["bbox_results"] if isinstance(content, dict) else content
        chosen = samples.of_scenes(scenes)
        if len(entries) == len(chosen.by_time) != len(samples.by_time):
            samples = chosen
    return opened.format.read(opened.path, content, samples)


def _join_files(parts: Sequence[FilePlans], opened: Sequence[RecognisedFile], samples: RecordedSamples) -> FilePlans:
    """Plans of several files together; a sample in two of them must have the same plan in both."""
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    at: dict[int, int] = {}
    rows: list[int] = []
    waypoints: list[Floats] = []
    repeated = 0
    for part, file in zip(parts, opened, strict=True):
        for row, plan in zip(part.rows.tolist(), part.waypoints):
            if row in at:
                if not np.array_equal(waypoints[at[row]], plan):
                    fault = f"sample {samples.tokens[row]} has another plan than in an earlier file"
                    refuse(file.path, "duplicate", fault, "name files of one run")
                repeated += 1
                continue
            at[row] = len(rows)
            rows.append(row)
            waypoints.append(plan)
    planned = {samples.tokens[row] for row in rows}
    skipped = {token: why for part in parts for token, why in part.skipped.items() if token not in planned}
    return FilePlans(
        frame=first.frame,
        rows=np.array(rows, np.int64),
        waypoints=np.array(waypoints),
        order=first.order,
        shown_by=first.shown_by,
        skipped=skipped,
        duplicates=repeated + sum(part.duplicates for part in parts),
        repaired=sum(part.repaired for part in parts),
        mirrored=first.mirrored if len({part.mirrored for part in parts}) == 1 else None,
    )
