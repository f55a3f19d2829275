"""What a record says of the machine is texts and numbers; anything else is damage, which judging anew must not mend."""

import json
from pathlib import Path

import pytest

from adapters.registry import planner_factory
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.records.run import load_record
from tests.benchmark.fake_data import town_of_two


def test_a_list_for_a_version_is_refused(tmp_path: Path) -> None:
    data = town_of_two()
    record = evaluate(data, "val", planner_factory("constant-velocity"), tmp_path, EvalSettings(limit=1))
    path = record.directory / "run.json"
    stored = json.loads(path.read_text())
    assert load_record(record.directory).run.environment == stored["environment"]
    stored["environment"]["packages"]["torch"] = [1, "a", None]
    path.write_text(json.dumps(stored))
    with pytest.raises(InputError, match=r"run\.json .*environment"):
        load_record(record.directory)
