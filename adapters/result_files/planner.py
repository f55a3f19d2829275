"""``--results FILE``: the plans of result files as a planner that is evaluated like any other."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from adapters.models import published_as
from adapters.result_files.contract import LONG_PLAN_STEPS
from adapters.result_files.importing import ImportedPlans, import_results
from adapters.result_files.recognition import RecognisedFile
from adapters.result_files.samples import read_recorded_samples
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, file_sha256
from benchmark.planning import Observation, Plan, SceneInfo
from benchmark.records.caveats import Caveat
from benchmark.records.planner_versions import PLANS_SHA256
from benchmark.records.run_schema import PlanFileFacts, PlannerFacts
from benchmark.report.words import pluralise
from benchmark.runs.code_identity import code_sha256
from benchmark.runs.planner_facts import require_known_native
from benchmark.untrusted.plan_plausibility import FrameName
from benchmark.untrusted.plan_verdicts import describe_checks, make_as_is_caveat

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_MAKER = "adapters.result_files.importing:import_results"


class ResultFilePlanner:
    """Planner that gives the plans of result files by sample token, or the reason in `skipped`."""

    def __init__(self, name: str, plans: Mapping[str, Plan], skipped: Mapping[str, str]) -> None:
        self.name = name
        self._plans, self._skipped = plans, skipped

    def reset(self, scene: SceneInfo) -> None:
        """Nothing is remembered."""

    def plan(self, observation: Observation) -> Plan:
        """The plan of the sample; that the files have none is recorded as a failure of this sample."""
        plan = self._plans.get(observation.sample_token)
        if plan is None:
            why = self._skipped.get(observation.sample_token)
            raise InputError("the result file has no plan for this sample" + (f": {why}" if why else ""))
        return plan


@dataclass(frozen=True, slots=True)
class ResultFileFactory:
    """Builds the planner of result files in any process."""

    facts: PlannerFacts
    plans_from: PlanFileFacts
    plans: Mapping[str, Plan]
    skipped: Mapping[str, str]
    caveats: tuple[Caveat, ...] = ()

    def __call__(self) -> ResultFilePlanner:
        """Build it."""
        return ResultFilePlanner(self.facts.name, self.plans, self.skipped)

    @property
    def sentences(self) -> list[str]:
        """Sentences about the import, for the terminal."""
        plans_from = self.plans_from
        lines = [
            f"{', '.join(plans_from.files)}: {plans_from.format}, {plans_from.plans} plans for "
            f"{pluralise(plans_from.samples, 'sample')}; order {plans_from.order}: {plans_from.shown_by}"
        ]
        if plans_from.mirrored is not None:
            lines.append(f"x is {'mirrored in the file and turned back' if plans_from.mirrored else 'not mirrored'}")
        if plans_from.skipped:
            first = next(iter(plans_from.skipped.items()))
            lines.append(f"{pluralise(len(plans_from.skipped), 'sample')} skipped, the first {first[0]}: {first[1]}")
        if plans_from.repaired:
            lines.append(
                f"{pluralise(plans_from.repaired, 'plan')} completed by the repository's own rule "
                "(docs/your-results.md)"
            )
        if plans_from.duplicates:
            lines.append(f"{pluralise(plans_from.duplicates, 'entry', 'entries')} repeated and left out")
        if plans_from.steps == LONG_PLAN_STEPS:
            lines.append("plans of 6 s: protocols use the first 3 s of a planner that was trained for 6 s")
        return [*lines, describe_checks(plans_from.checks), f"the record has no {', no '.join(plans_from.lacks)}"]


def result_file_factory(
    opened: Sequence[RecognisedFile],
    data: "DataSet",
    split: str,
    *,
    scenes: tuple[str, ...] | None = None,
    name: str | None = None,
    native: str | None = None,
    frame: FrameName | None = None,
    as_is: bool = False,
) -> ResultFileFactory:
    """The planner of result files, checked against the samples that they are for.

    Args:
        opened: Files of one run (`adapters.result_files.recognition.recognise`).
        data: The data set.
        split: The split.
        scenes: Only these scenes will be evaluated; the whole split by default.
        name: Shown in tables; the first file's name without its ending by default.
        native: Protocol of the repository that the planner comes from, if it is not that of the format.
        frame: Frame of the waypoints, ``lidar`` or ``ego``, if it is not that of the format.
        as_is: Take plans unchanged, even if another unit, frame, origin or time fits better; the record notes it.

    Returns:
        A factory for `benchmark.evaluation.evaluate`.

    Raises:
        RefusedFile: If a file is broken, or its plans are not of these samples or cannot be what they must be.
        InputError: If the data is broken, or the native protocol is unknown.
    """
    paths = [file.path for file in opened]
    require_known_native(native, f"result file {paths[0]}")
    every = read_recorded_samples(data, split)
    imported = import_results(opened, every, scenes, frame=frame, as_is=as_is)
    misreading = imported.plausibility.misreading
    name = name or paths[0].stem
    names = [path.name for path in paths]
    numbered = [name if names.count(name) == 1 else f"{name} ({at})" for at, name in enumerate(names, start=1)]
    hashes = {name: _sha256(path) for name, path in zip(numbered, paths, strict=True)}
    facts = PlannerFacts(
        name=name,
        privileged=False,
        weights_sha256=None,
        code_sha256=code_sha256(ResultFilePlanner, made_by=_MAKER),
        settings={
            PLANS_SHA256: next(iter(hashes.values())) if len(hashes) == 1 else content_key(sorted(hashes.values())),
            **({} if frame is None else {"frame": frame}),
        },
        native_protocol=native or imported.format.native,
        published_as=published_as(name),
    )
    return ResultFileFactory(
        facts,
        _describe_import(imported, hashes, len(every.tokens)),
        imported.plans,
        imported.found.skipped,
        () if misreading is None else (make_as_is_caveat(misreading),),
    )


def _describe_import(imported: ImportedPlans, hashes: dict[str, str], samples: int) -> PlanFileFacts:
    file_plans = imported.found
    steps = file_plans.waypoints.shape[1]
    lacks = [item for item in imported.format.lacks if steps < LONG_PLAN_STEPS or not item.startswith("plans beyond")]
    return PlanFileFacts(
        format=imported.format.name,
        files=hashes,
        order=file_plans.order,
        shown_by=file_plans.shown_by,
        plans=len(file_plans.rows),
        samples=samples,
        steps=steps,
        skipped=dict(file_plans.skipped),
        duplicates=file_plans.duplicates,
        repaired=file_plans.repaired,
        mirrored=file_plans.mirrored,
        checks=imported.plausibility.measured,
        lacks=lacks,
    )


def _sha256(path: Path) -> str:
    """Hash of a file; of a folder over name, zero byte and digest of each file in the order of names."""
    if not path.is_dir():
        return file_sha256(path)
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()):
        digest.update(file.name.encode() + b"\0" + bytes.fromhex(file_sha256(file)))
    return digest.hexdigest()
