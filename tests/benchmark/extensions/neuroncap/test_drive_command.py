"""``drive --engine neuroncap@...`` as a user runs it."""

from pathlib import Path

import pytest

from tests.benchmark.cli import test_drive_trouble as any_engine
from tests.benchmark.cli.test_drive_trouble import driving, road


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return road(tmp_path_factory.mktemp("data") / "road")


def test_neuroncaps_engine_has_a_table_of_its_own(source: Path, tmp_path: Path) -> None:
    done = driving(source, tmp_path, "--engine", "neuroncap@paper", "--runs", "7", "--model", "stop", "--no-baselines")
    assert done.code == 0 and "engine neuroncap@paper" in done.out and "NNS" in done.out
    (record,) = tmp_path.rglob("*neuroncap*/stop/drives.jsonl")
    assert len(record.read_text().splitlines()) == 1


def test_who_fails_is_counted_and_scored_nowhere(source: Path, tmp_path: Path) -> None:
    any_engine.test_who_fails_is_counted_and_scored_nowhere(
        source, tmp_path, "Poisoned", "neuroncap@code", "unusable plan"
    )


def test_six_identical_points_are_driven(source: Path, tmp_path: Path) -> None:
    any_engine.test_six_identical_points_are_driven(source, tmp_path, "neuroncap@code")
