"""From a drive to a data set that is learned from: the ego learns the way back to the recorded path."""

from pathlib import Path

import numpy as np
import pytest

from adapters.extensions.training.dataset_mixture import build_frames
from benchmark.datasets.roots import open_data
from benchmark.records.driven_ego import read_driven_ego_targets
from benchmark.records.drives import find_drives
from tests.benchmark.cli.cli_runs import challenger_bench
from tests.benchmark.cli.test_driven_town import SMALL, town_and_drive


@pytest.mark.slow
def test_frames_of_a_driven_town_are_of_the_way_back(tmp_path: Path) -> None:
    place = town_and_drive(tmp_path)
    (record,) = find_drives(place / "train replay")
    driven = ("--root", place / "driven", "--driven", place / "train replay", *SMALL)
    assert challenger_bench("data", "build", *driven).code == 0
    data = open_data(place / "driven")
    store = build_frames(data.root, "train", place / "frames")
    for row in record.rows:
        learned = read_driven_ego_targets(data.provenance(), row.scene)
        assert learned is not None
        frames = [store.frame(number) for number in store.frames_of(row.scene)]
        assert [frame.command for frame in frames] == row.ticks.command
        assert np.array_equal([frame.ego_future_valid.numpy() for frame in frames], learned.known)
        for frame, wanted, known in zip(frames, learned.wanted, learned.known, strict=True):
            right, forward = frame.ego_future.numpy().T
            turn = frame.global_T_lidar.numpy()
            told = turn[:2, 3] + right[:, None] * turn[:2, 0] + forward[:, None] * turn[:2, 1]
            assert np.abs(told - wanted)[known].max(initial=0.0) < 2e-3
