"""What the site's index says of planners: what ran, its rates under every protocol, and its driving scores."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

from benchmark.metrics.effect import attributes, says_whom, touched_scenes
from benchmark.metrics.rates import Rate
from benchmark.metrics.scores import registered_version
from benchmark.records.driving import SUB_SCORES, TOTALS, VERSION
from benchmark.records.file_plans import file_notes
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import DrivingSummary, ProtocolSummary
from leaderboard.frame.rows import in_table_order, recordings

_SHOWN_COLUMNS: Final = ("collision", "l2")
_DIGITS: Final = 6
"""Decimals of rates: pages show two of a percentage."""


def model_index(records: Sequence[RunRecord]) -> list[dict[str, Any]]:
    """Planners in the order of tables, of at most one record for each data set, split and planner."""
    runs_of: dict[str, list[RunRecord]] = {}
    for record in in_table_order(records):
        runs_of.setdefault(record.planner, []).append(record)
    return [
        {
            "name": name,
            "privileged": runs[0].run.planner.privileged,
            "miniature": runs[0].run.planner.miniature,
            "nativeProtocol": runs[0].run.planner.native_protocol,
            "facts": {
                "seed": runs[0].run.planner.seed,
                "settings": _words(runs[0].run.planner.settings),
                "weights": runs[0].run.planner.weights_sha256,
            },
            "runs": [_run(record) for record in runs],
        }
        for name, runs in runs_of.items()
    ]


def _run(record: RunRecord) -> dict[str, Any]:
    """One run; code, commit and machine are of the run, because two runs of a planner may differ in them."""
    run, summary = record.run, record.summary
    environment = run.environment
    source = _words(environment.get("source") or {})
    return {
        "record": record.content_id,
        "data": run.data.name,
        "split": run.split,
        "fingerprint": run.data.fingerprint,
        "code": run.planner.code_sha256,
        "commit": source.get("commit"),
        "dirty": source.get("dirty"),
        "hardware": _words(environment.get("hardware") or {}),
        "packages": _words(environment.get("packages") or {}),
        "rescored": run.rescored is not None,
        "samples": summary.samples,
        "failed": summary.failed,
        "coverage": summary.coverage,
        "scenes": len(run.scenes),
        "scenesInSplit": run.scenes_in_split,
        "recordings": recordings(record),
        "protocols": {
            name: {
                **_protocol(of_protocol, stale=name in record.stale_protocols),
                "scenesHit": _scenes_hit(record, name),
            }
            for name, of_protocol in summary.protocols.items()
        },
        "driving": None if summary.driving is None else _driving(summary.driving),
        **({} if run.plans_from is None else {"plansFrom": file_notes([record])[0]}),
    }


def _driving(summary: DrivingSummary) -> dict[str, Any]:
    """Driving scores: the mean of each sub-score and of the totals."""
    return {
        "version": summary.version,
        "stale": summary.version != VERSION,
        "counted": summary.counted,
        "means": {name: _rate(summary.columns[name]["mean"]) for name in (*TOTALS, *SUB_SCORES)},
    }


def _scenes_hit(record: RunRecord, protocol: str) -> list[int] | None:
    """Numbers of scenes with a sample that touches the adversary first, and of scenes where that is said."""
    told = attributes(record) and registered_version(protocol) is not None and says_whom(record, protocol)
    if not told:
        return None
    verdicts = touched_scenes(record, protocol).values()
    return [sum(failed is True for failed in verdicts), sum(failed is not None for failed in verdicts)]


def _protocol(summary: ProtocolSummary, *, stale: bool) -> dict[str, Any]:
    shown = {name: summary.columns[name] for name in _SHOWN_COLUMNS if name in summary.columns}
    return {
        "version": summary.version,
        "stale": stale,
        "counted": summary.counted,
        "scenesFailed": summary.scenes_failed,
        "scenesDecided": summary.scenes_decided,
        **{name: {horizon: _rate(rate) for horizon, rate in by_horizon.items()} for name, by_horizon in shown.items()},
    }


def _rate(rate: Rate) -> dict[str, float | int | None]:
    return {
        "value": _rounded(rate.value),
        "low": _rounded(rate.low),
        "high": _rounded(rate.high),
        "n": rate.denominator,
    }


def _words(facts: Any) -> dict[str, str | None]:
    """Facts of a stranger's record as text: they may hold anything that JSON can, NaN too."""
    if not isinstance(facts, Mapping):
        return {}
    return {str(name): _said(value) for name, value in facts.items()}


def _said(value: Any) -> str | None:
    return value if value is None or isinstance(value, str) else json.dumps(value)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, _DIGITS)
