"""Run records from a few characters: what each sample of each scene does at its six steps."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.protocols import PROTOCOLS
from benchmark.records.row_schema import OutcomeRow, SampleRow
from benchmark.records.run import RunRecord, summarise_rows
from benchmark.records.run_schema import DataFacts, PlannerFacts, RunFacts, SceneFacts
from tests.benchmark.records.test_run import row

CLEAN, HIT, LATE = "......", "xxxxxx", ".....x"
FAILED = None
"""A sample that the planner raised on."""
_NEVER = ("recorded", "obj_col", "kerb", "kerb_before_mask", "kerb_point", "off_road")
"""Columns of protocols that say no at every step."""
UNCOUNTED = "-"
"""A sample whose recording ends before 3 s, clean."""


def hand_made(
    planner: str,
    scenes: Mapping[str, Sequence[str | None]],
    *,
    split: str = "adv",
    protocols: Sequence[str] = ("exact",),
    sources: Mapping[str, str] | None = None,
    native: str | None = None,
    versions: Mapping[str, int] | None = None,
    weights: str | None = None,
    data: str = "d",
    scenes_in_split: int | None = None,
    privileged: bool = False,
) -> RunRecord:
    """A record whose samples collide under every protocol where ``scenes`` has an ``x``."""
    rows = tuple(
        _row(scene, index, flags, protocols) for scene, samples in scenes.items() for index, flags in enumerate(samples)
    )
    judged = {name: (versions or {}).get(name, PROTOCOLS[name].version) for name in protocols}
    facts = {scene: SceneFacts(source=source) for scene, source in (sources or {}).items()}
    summary = summarise_rows(rows, judged, seed=0, scene_facts=facts)
    run = RunFacts(
        schema=2,
        planner=PlannerFacts(name=planner, privileged=privileged, native_protocol=native, weights_sha256=weights),
        data=DataFacts(name=data, version="v", fingerprint=f"{data} {split}"), split=split, scenes=list(scenes),
        scenes_in_split=len(scenes) if scenes_in_split is None else scenes_in_split, scene_facts=facts,
        status="partial" if summary.failed else "complete", protocols=judged, seed=0, config={}, environment={},
        files={},
    )  # fmt: skip
    return RunRecord(Path(split) / planner, run, rows, summary)


def facts_of(run: RunFacts) -> dict[str, Any]:
    """What `write_record` was given of a run."""
    left_out = {"schema_version", "status", "protocols", "seed", "files"}
    return {name: value for name, value in dict(run).items() if name in RunFacts.model_fields and name not in left_out}


def _row(scene: str, index: int, flags: str | None, protocols: Sequence[str]) -> SampleRow:
    counted = flags != UNCOUNTED
    plain = row(scene, index, counted=counted, status="failed" if flags is None else "ok")
    if flags is None:
        return plain
    steps = [flag == "x" for flag in (flags if counted else CLEAN)]
    outcome = OutcomeRow(
        collision=steps, l2=plain.outcomes["exact"].l2, counted=counted,
        steps={"waypoint_collision": steps, "before_mask": steps, **dict.fromkeys(_NEVER, [False] * 6)},
        facts={"map": True, "on_road_now": 1.0},
    )  # fmt: skip
    return plain.model_copy(update={"outcomes": dict.fromkeys(protocols, outcome)})
