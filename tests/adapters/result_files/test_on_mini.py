"""A miniature on the embedded town, its plans through every format and back: the records say the same."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.registry import planner_factory
from adapters.result_files.planner import result_file_factory
from adapters.result_files.recognition import recognise
from adapters.result_files.samples import read_recorded_samples
from adapters.result_files.synthetic import PRECISION_M
from adapters.result_files.writing.formats import WRITERS, write_results
from benchmark.datasets.roots import DataSet, open_data
from benchmark.evaluation import evaluate
from benchmark.records.run import RunRecord
from generation.sources.mini import TownSettings, build_town_data_set


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[DataSet, RunRecord]]:
    folder = tmp_path_factory.mktemp("mini")
    settings = TownSettings(val_scenes=1, width=96, height=54, frames="keyframes")
    data = open_data(build_town_data_set(folder / "root", settings, workers=1), name="mini")
    yield data, evaluate(data, "val", planner_factory("vad-mini", device="cpu"), folder / "runs")


@pytest.mark.parametrize("name", list(WRITERS))
def test_every_format_gives_the_record_again(planned: tuple[DataSet, RunRecord], name: str, tmp_path: Path) -> None:
    data, record = planned
    path = write_results(record, read_recorded_samples(data, "val"), name, tmp_path)
    factory = result_file_factory([recognise(path)], data, "val", native="vad")
    found = evaluate(data, "val", factory, tmp_path / "runs")
    assert found.run.caveats == record.run.caveats == []
    assert found.complete and record.complete and os.fspath(found.directory) != os.fspath(record.directory)
    differing = 0
    for row, again in zip(record.rows, found.rows, strict=True):
        assert row.sample_token == again.sample_token and again.plan is not None and again.plan.forecasts is None
        for protocol in row.outcomes:
            differing += row.outcomes[protocol].collision != again.outcomes[protocol].collision
        assert (row.driving is None) == (again.driving is None)
    # Rounded to a centimetre, a verdict at the edge of a box may change.
    assert differing <= (6 if PRECISION_M.get(name, 0.0) > 0.001 else 0)
