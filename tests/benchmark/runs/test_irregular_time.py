"""Runs on roots whose key frames are not half a second apart: what is said of which horizon, and by whom."""

from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.schema.check import check_tables
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.metrics.disagreement import compare_protocols
from benchmark.metrics.frames import samples_frame
from benchmark.metrics.rates import HORIZONS
from benchmark.metrics.scores import score_record
from benchmark.metrics.significance import compare_planners
from benchmark.protocols import PROTOCOLS, STANDARD
from benchmark.records.caveats import Caveat
from benchmark.records.rows import find_scene_failures
from benchmark.records.run import RunRecord
from benchmark.runs.rescoring import rescore
from benchmark.scene import Scene
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.collision import collision_table
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.benchmark.irregular_time import at_other_times, with_key_frames, without_key_frames
from tests.benchmark.planners import Straight
from tests.hand_made import Car, scene_on_straight_road

SLOW = Car(75.0, 198.25, 2.0)
"""A leader that the plan of 8 m/s runs into, from the second sample on within 3 s."""


def town(*cars: Car, seconds: float = 8.0, ego_speed: float = 8.0) -> Scene:
    return scene_on_straight_road(cars or (Car(60.0, 194.75, 10.0),), seconds=seconds, ego_speed=ego_speed)


def run(scene: Scene, folder: Path, protocols: tuple[str, ...] = STANDARD) -> RunRecord:
    root = TinyRoot.of(folder / "root", [scene], cameras=()).write()
    return evaluate(NuScenesData.open(root), "val", Straight(), folder / "runs", EvalSettings(protocols=protocols))


def time_caveats_of(record: RunRecord) -> list[Caveat]:
    """These small roots have no map, which is another one."""
    return [caveat for caveat in record.run.caveats if caveat.kind == "time"]


def denominators(record: RunRecord, protocol: str, column: str = "collision") -> list[int]:
    return [rate.denominator for rate in record.summary.protocols[protocol].columns[column].values()]


def test_regular_roots_have_no_caveat(tmp_path: Path) -> None:
    gaps = np.random.default_rng(3).uniform(0.4, 0.6, 15)
    record = run(at_other_times(town(), gaps), tmp_path)
    assert time_caveats_of(record) == [] and denominators(record, "exact") == [10] * 4
    truth = record.run.scene_facts["scene-9901"].truth
    assert truth is not None and (truth.irregular, truth.cut_short, truth.interval_s) == (0, 0, None)
    assert not [fault for fault in check_tables(tmp_path / "root") if "apart" in fault.sentence]


def test_a_missing_key_frame_leaves_horizons_out_one_by_one(tmp_path: Path) -> None:
    record = run(without_key_frames(town(ego_speed=7.0), 7), tmp_path)
    known = [sum(one is not None for one in row.outcomes["exact"].l2) for row in record.rows]
    assert known == [6, 5, 4, 3, 2, 1, 0, 6, 6, 5, 4, 3, 2, 1, 0]
    # 0.5 m/s too fast: never the displacement from where the ego was a second later, which is 3 m at the first step.
    for row in record.rows:
        assert [one for one in row.outcomes["exact"].l2 if one is not None] == pytest.approx(
            0.5 * np.arange(1, 1 + sum(one is not None for one in row.outcomes["exact"].l2)), abs=1e-3
        )
    for column in ("collision", "l2", "ade"):
        assert denominators(record, "exact", column) == [7, 5, 3, 3]
    assert denominators(record, "vad") == [9] * 4 and denominators(record, "uniad") == [15] * 4
    assert record.rows[6].outcomes["vad"].l2[0] == pytest.approx(3.0, abs=1e-3)
    summary = record.summary.protocols["exact"]
    assert (summary.counted, summary.incomplete) == (3, 12)
    frame = samples_frame(record)
    assert frame["exact collision 1s"].notna().sum() == 7 and frame["exact l2 3s"].notna().sum() == 3
    assert [row.complete for row in record.rows[:9]] == [True] + [False] * 6 + [True] * 2


def test_the_record_says_so_and_its_row_is_marked(tmp_path: Path) -> None:
    record = run(without_key_frames(town(), 7), tmp_path)
    (caveat,) = time_caveats_of(record)
    assert caveat.kind == "time" and caveat.sentence.startswith("6 samples of 1 scene have key frames ahead that are")
    assert "beyond a gap over 0.75 s (6 samples)" in caveat.sentence
    table = collision_table(DataSetRuns("root", [record]), "exact")
    assert table.rows[0][0] == "straight ¶" and any(caveat.sentence in note for note in table.notes)
    again = rescore(record.directory, NuScenesData.open(tmp_path / "root"), protocols=STANDARD)
    assert time_caveats_of(again) == [caveat] and again.rows == record.rows


def test_what_is_unknown_is_no_absence_of_contacts(tmp_path: Path) -> None:
    # Samples before the gap count in part; the only whole ones come too late in the scene to be followed for 3 s.
    short = without_key_frames(town(SLOW, seconds=4.0), 5)
    record = run(short, tmp_path / "contact")
    partial = [row for row in record.rows if row.outcomes["exact"].counted]
    assert partial and all(row.outcomes["exact"].cut_short for row in partial)
    collides = any(any(row.outcomes["exact"].collision or ()) for row in partial)
    assert find_scene_failures(record.rows, "exact") == {"scene-9901": True if collides else None}
    assert record.summary.protocols["exact"].scenes_decided == int(collides)
    clear = run(without_key_frames(town(seconds=4.0), 5), tmp_path / "clear")
    assert find_scene_failures(clear.rows, "exact") == {"scene-9901": None}
    assert clear.summary.protocols["exact"].scenes_decided == 0


def test_a_contact_before_the_gap_fails_the_scene(tmp_path: Path) -> None:
    near = Car(60.0, 198.25, 2.0)
    record = run(without_key_frames(town(near, seconds=4.0), 5), tmp_path)
    assert find_scene_failures(record.rows, "exact") == {"scene-9901": True}
    first = record.rows[0].outcomes["exact"]
    assert first.collision is not None and first.collision[:2] != [False, False]
    assert first.cut_short and first.l2[4] is None


def test_comparisons_leave_out_what_is_unknown(tmp_path: Path) -> None:
    gap, whole = (
        run(scene, tmp_path / name)
        for name, scene in (("gap", without_key_frames(town(SLOW), 7)), ("whole", town(SLOW)))
    )
    judged = score_record(gap)
    assert np.isnan(judged.values[judged.counted]).any()
    sums = judged.sums({"scene-9901": "scene-9901"})
    assert sums.denominators.tolist() == [[7.0, 5.0, 3.0, 3.0]] and not np.isnan(sums.numerators).any()
    compared = compare_planners(score_record(gap), score_record(gap))
    assert {name: one.difference.value for name, one in compared.by_horizon.items()} == dict.fromkeys(HORIZONS, 0.0)
    assert denominators(whole, "exact") == [10] * 4
    assert compare_protocols(gap)["vad"].samples.compared == 3


@pytest.mark.parametrize("every", [1, 3])
def test_at_another_rate_exact_says_the_same_and_official_protocols_say_nothing(tmp_path: Path, every: int) -> None:
    scene = town(SLOW, Car(60.0, 194.75, 10.0))
    usual = run(scene, tmp_path / "usual", tuple(PROTOCOLS))
    dense = run(
        with_key_frames(scene, np.arange(0, scene.keyframes[-1] + 1, every)), tmp_path / "dense", tuple(PROTOCOLS)
    )
    for row in usual.rows:
        same = dense.rows[row.index * 6 // every].outcomes["exact"]
        assert same.collision == row.outcomes["exact"].collision and same.counted == row.outcomes["exact"].counted
    for name in PROTOCOLS:
        assert dense.summary.protocols[name].counted == (len(dense.rows) - 36 // every if name == "exact" else 0)
        if name != "exact":
            assert all(rate.value is None for rate in dense.summary.protocols[name].columns["collision"].values())
            assert set(find_scene_failures(dense.rows, name).values()) == {None}
    (caveat,) = time_caveats_of(dense)
    assert caveat.kind == "time" and f"{every / 12:.3g} s apart, not 0.5 s" in caveat.sentence
    assert "–" in collision_table(DataSetRuns("root", [dense]), "vad").markdown()


def test_key_frames_farther_apart_than_steps_may_be_say_nothing(tmp_path: Path) -> None:
    scene = town()
    record = run(with_key_frames(scene, scene.keyframes[::2]), tmp_path)
    assert denominators(record, "exact") == [0] * 4 and denominators(record, "uniad") == [0] * 4
    assert all(set(row.outcomes["exact"].l2) == {None} for row in record.rows)
