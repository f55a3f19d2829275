"""Documents of every-eval-ever 0.3.0: rates with intervals and counts, for archives of results.

Its package wants Python 3.12, so its rules are stated here again; `verify hub` compares them with its schema's.
"""

import json
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, NamedTuple

from benchmark.constants import VERSION
from benchmark.machine.storage import content_key
from benchmark.metrics.rates import RESAMPLES, Rate
from benchmark.records.drives import COLLISION_RATE, NNS, DriveRecord, compute_columns
from benchmark.records.run import RunRecord

SCHEMA_VERSION: Final = "0.3.0"


class _Scale(NamedTuple):
    """What a column's number is multiplied with, its unit, its largest value, and whether less is better."""

    factor: float
    unit: str
    largest: float | str
    lower_is_better: bool


_SHARE: Final = _Scale(100.0, "percent", 100.0, True)
_METRES: Final = _Scale(1.0, "m", "Infinity", True)
_SCORE: Final = _Scale(1.0, "points", 1.0, False)
_OPEN: Final = {"collision": _SHARE, "collision_before_mask": _SHARE, "obj_col": _SHARE, "l2": _METRES, "ade": _METRES}
_CLOSED: Final = {
    **dict.fromkeys(("contact", COLLISION_RATE, "at_fault", "with_adversary", "attributable", "off_road"), _SHARE),
    **dict.fromkeys(("nuplan_score", "hd_score"), _SCORE),
    NNS: _Scale(1.0, "points", 5.0, False),
}


@dataclass(frozen=True, slots=True)
class EvaluationDocument:
    """One document; ``uuid`` is a random one's form of its content."""

    content: Mapping[str, Any]

    @property
    def uuid(self) -> str:
        """The same for the same content."""
        return str(uuid.UUID(content_key(self.content)[:32], version=4))

    def encode(self) -> bytes:
        """As JSON."""
        return (json.dumps(self.content, ensure_ascii=False, allow_nan=False, indent=1) + "\n").encode()


def build_document(
    record: RunRecord | DriveRecord, planner: str, organisation: str, data_set: str, day: str
) -> EvaluationDocument:
    """The document of a record: collision rates and distances of every protocol, or scores of drives.

    Args:
        record: Of planning or of driving.
        planner: Its planner's name among others.
        organisation: On whose hub pages data set and planner are.
        data_set: Its name there.
        day: ``YYYY-MM-DD``.

    Returns:
        A document that `check_document` accepts.
    """
    facts = record.run if isinstance(record, RunRecord) else record.facts
    seconds = str(int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()))
    source = {
        "dataset_name": data_set,
        "source_type": "hf_dataset",
        "hf_repo": f"{organisation}/{data_set}",
        "hf_split": facts.split,
    }
    content = {
        "schema_version": SCHEMA_VERSION,
        "evaluation_id": f"{organisation}/{data_set}/{planner}/{record.content_id}",
        "retrieved_timestamp": seconds,
        "source_metadata": {
            "source_name": "challenger-bench record",
            "source_type": "evaluation_run",
            "source_organization_name": organisation,
            "evaluator_relationship": "other",
            "additional_details": {"record": record.content_id, "data_sha256": facts.data.fingerprint},
        },
        "eval_library": {"name": "challenger-bench", "version": VERSION},
        "model_info": {
            "name": planner,
            "id": f"{organisation}/{planner}",
            "additional_details": {"deployment_type": "unknown", "model_availability": "unknown"},
        },
        "evaluation_results": [
            {"evaluation_name": f"{data_set} {facts.split}: {name}", "source_data": source, **measured}
            for name, measured in _list_results(record)
        ],
    }
    check_document(content)
    return EvaluationDocument(content)


def _list_results(record: RunRecord | DriveRecord) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name, metric and score of each number; columns without a scale here stand in ``rates.parquet`` alone."""
    if isinstance(record, RunRecord):
        for protocol, summary in record.summary.protocols.items():
            for column, horizons in summary.columns.items():
                if column in _OPEN and "avg" in horizons and horizons["avg"].value is not None:
                    parts = {name: rate for name, rate in horizons.items() if name != "avg"}
                    by = f"{protocol} v{summary.version}"
                    yield f"{by} {column}", _build_result(by, column, _OPEN[column], horizons["avg"], parts)
        return
    by = f"{record.facts.measured.world}, scores v{record.facts.scoring}"
    for column, rate in compute_columns(record).items():
        if column in _CLOSED and rate.value is not None:
            yield f"{by} {column}", _build_result(by, column, _CLOSED[column], rate, {})


def _build_result(by: str, column: str, scale: _Scale, rate: Rate, parts: Mapping[str, Rate]) -> dict[str, Any]:
    assert rate.value is not None
    uncertainty: dict[str, Any] = {"num_samples": rate.denominator}
    if rate.low is not None and rate.high is not None:
        uncertainty["confidence_interval"] = {
            "lower": scale.factor * rate.low,
            "upper": scale.factor * rate.high,
            "confidence_level": 0.95,
            "method": "bootstrap over recorded scenes",
        }
        uncertainty["num_bootstrap_samples"] = RESAMPLES
    details = {name: repr(scale.factor * part.value) for name, part in parts.items() if part.value is not None}
    return {
        "metric_config": {
            "metric_id": column,
            "metric_name": f"{column}, {by}",
            "metric_unit": scale.unit,
            "lower_is_better": scale.lower_is_better,
            "score_type": "continuous",
            "min_score": 0.0,
            "max_score": scale.largest,
        },
        "score_details": {"score": scale.factor * rate.value, "details": details, "uncertainty": uncertainty},
    }


def check_document(document: Any) -> None:
    """``ValueError`` where a document breaks a rule of the schema, with where and which."""
    _DOCUMENT(document, "document")
    unknown = sorted(set(document) - _TOP)
    if unknown:
        raise ValueError(f"document has {unknown[0]!r}, which the schema does not know")


_Rule = Callable[[Any, str], None]


def _of(kind: type | tuple[type, ...], what: str) -> _Rule:
    def check(value: Any, where: str) -> None:
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise ValueError(f"{where} is no {what}")

    return check


def _one_of(*known: Any) -> _Rule:
    def check(value: Any, where: str) -> None:
        if value not in known:
            raise ValueError(f"{where} is none of {', '.join(map(repr, known))}")

    return check


def _object(required: Mapping[str, _Rule], optional: Mapping[str, _Rule] | None = None) -> _Rule:
    def check(value: Any, where: str) -> None:
        if not isinstance(value, dict):
            raise ValueError(f"{where} is no object")
        if absent := [name for name in required if name not in value]:
            raise ValueError(f"{where} has no {absent[0]}")
        for name, rule in {**required, **(optional or {})}.items():
            if name in value:
                rule(value[name], f"{where}.{name}")

    return check


def _list_of(rule: _Rule) -> _Rule:
    def check(value: Any, where: str) -> None:
        if not isinstance(value, list):
            raise ValueError(f"{where} is no list")
        for number, item in enumerate(value):
            rule(item, f"{where}[{number}]")

    return check


def _texts(value: Any, where: str) -> None:
    if not isinstance(value, dict) or not all(isinstance(text, str) for text in value.values()):
        raise ValueError(f"{where} is no object of texts")


_TEXT, _NUMBER, _COUNT = _of(str, "text"), _of((int, float), "number"), _of(int, "whole number")


def _bound(value: Any, where: str) -> None:
    if value is not None and value not in ("Infinity", "-Infinity"):
        _NUMBER(value, where)


def _source(value: Any, where: str) -> None:
    _object({"dataset_name": _TEXT, "source_type": _one_of("url", "hf_dataset", "other")})(value, where)
    optional = {"hf_repo": _TEXT, "hf_split": _TEXT, "samples_number": _COUNT, "sample_ids": _list_of(_TEXT)}
    if value["source_type"] == "url":
        _object({"url": _list_of(_TEXT)})(value, where)
    elif value["source_type"] == "hf_dataset":
        _object({}, optional)(value, where)


def _metric(value: Any, where: str) -> None:
    named = dict.fromkeys(("metric_id", "metric_name", "metric_kind", "metric_unit"), _TEXT)
    kinds = _one_of("binary", "continuous", "levels")
    _object({"lower_is_better": _of(bool, "truth value")}, {**named, "score_type": kinds})(value, where)
    if value.get("score_type") == "continuous":
        _object({"min_score": _bound, "max_score": _bound})(value, where)
    elif value.get("score_type") == "levels":
        _object({"level_names": _list_of(_TEXT), "has_unknown_level": _of(bool, "truth value")})(value, where)


_INTERVAL: Final = _object({"lower": _NUMBER, "upper": _NUMBER}, {"confidence_level": _NUMBER, "method": _TEXT})
_UNCERTAINTY: Final = _object(
    {},
    {
        "standard_error": _object({"value": _NUMBER}, {"method": _TEXT}),
        "confidence_interval": _INTERVAL,
        "standard_deviation": _NUMBER,
        "num_samples": _COUNT,
        "num_bootstrap_samples": _COUNT,
    },
)
_RESULT: Final = _object(
    {
        "evaluation_name": _TEXT,
        "source_data": _source,
        "metric_config": _metric,
        "score_details": _object({"score": _NUMBER}, {"details": _texts, "uncertainty": _UNCERTAINTY}),
    }
)
_MODEL_DETAILS: Final = _object(
    {
        "deployment_type": _one_of("self_deployed", "externally_managed", "unknown"),
        "model_availability": _one_of("open_weights", "closed_weights", "unknown"),
    }
)
_REQUIRED: Final[Mapping[str, _Rule]] = {
    "schema_version": _one_of(SCHEMA_VERSION),
    "evaluation_id": _TEXT,
    "retrieved_timestamp": _TEXT,
    "source_metadata": _object(
        {
            "source_type": _one_of("documentation", "evaluation_run"),
            "source_organization_name": _TEXT,
            "evaluator_relationship": _one_of("first_party", "third_party", "collaborative", "other"),
        },
        {"additional_details": _texts},
    ),
    "eval_library": _object({"name": _TEXT, "version": _TEXT}),
    "model_info": _object({"name": _TEXT, "id": _TEXT, "additional_details": _MODEL_DETAILS}),
    "evaluation_results": _list_of(_RESULT),
}
_OPTIONAL: Final[Mapping[str, _Rule]] = {"evaluation_timestamp": _TEXT, "detailed_evaluation_results": _object({})}
_DOCUMENT: Final = _object(_REQUIRED, _OPTIONAL)
_TOP: Final = {*_REQUIRED, *_OPTIONAL}
