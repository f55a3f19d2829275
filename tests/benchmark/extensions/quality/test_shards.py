"""Scores in shards and on several devices: the record of one command; what is missing is scored."""

import json
from pathlib import Path

import pytest

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.extensions.quality import musiq
from benchmark.extensions.quality.measure import measure_quality, measure_shard
from benchmark.records.quality import QualityRecord
from benchmark.runs.shards import Shard
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.quality.test_measure import PUBLISHED_SCALES, TWO, record, root, settings, small_scales

__all__ = ["record", "root", "small_scales"]


def shard(root: Path, networks: Path, out: Path, number: int, of: int, **changes: object) -> int:
    data = NuScenesData.open(root, name="painted")
    return measure_shard(data, "val", out, settings(networks, **changes), Shard(number, of)).done  # type: ignore[arg-type]


def finished(root: Path, networks: Path, out: Path, **changes: object) -> QualityRecord:
    data = NuScenesData.open(root, name="painted")
    return measure_quality(data, "val", out, settings(networks, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("of", [1, 2, 3])
def test_shards_become_the_bytes_of_one_command(
    root: Path, record: QualityRecord, networks: Path, tmp_path: Path, of: int
) -> None:
    done: list[int] = []
    written: dict[Path, int] = {}
    for number in range(of, 0, -1):
        done.append(shard(root, networks, tmp_path, number, of))
        now = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
        assert written.items() <= now.items()
        written = now
    assert sum(done) == len(TWO)
    made = finished(root, networks, tmp_path)
    assert bytes_below(made.directory) == bytes_below(record.directory)


def test_what_no_shard_scored_or_is_damaged_is_scored_by_the_command(
    root: Path, record: QualityRecord, networks: Path, tmp_path: Path
) -> None:
    shard(root, networks, tmp_path, 1, 2)
    (rows,) = tmp_path.rglob("scenes/*.json")
    rows.write_text(rows.read_text()[:-5])
    made = finished(root, networks, tmp_path)
    assert bytes_below(made.directory) == bytes_below(record.directory)


def test_two_devices_give_the_bytes_of_one(
    root: Path, networks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Other processes have the published ones.
    monkeypatch.setattr(musiq, "LONGER_SIDES_PX", PUBLISHED_SCALES)
    with pytest.raises(InputError, match="leaves some of cpu,cpu without work"):
        finished(root, networks, tmp_path, device="cpu,cpu", workers=1)
    one = finished(root, networks, tmp_path / "one", device="cpu")
    two = finished(root, networks, tmp_path / "two", device="cpu,cpu", workers=0)
    assert bytes_below(two.directory) == bytes_below(one.directory)


def test_the_command_takes_shards_and_finishes(root: Path, networks: Path, tmp_path: Path) -> None:
    given = ("--data", root, "--out", tmp_path)
    how = ("--split", "val", "--masks", "boxes", "--weights-folder", networks, "--device", "cpu", "--workers", "1")
    done = run_here("quality", *given, *how, "--shard", "2/2", "--json")
    assert done.code == 0 and [each["scored"] for each in json.loads(done.out)] == [1], done.err
    assert run_here("quality", *given, *how, "--shard", "1/2").code == 0
    assert run_here("quality", *given, *how).code == 0
