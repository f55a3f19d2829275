"""Open loop beside closed loop: the same scenes, nothing guessed where one cannot say."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.metrics.loops import compare_loops, compute_rank_correlation, find_run, is_stale, kendall_tau
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord
from benchmark.records.run import RunRecord
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, hand_made
from tests.benchmark.records.test_drives import contact, failed, row, written

SCENES = ("s1", "s2", "s3", "s4")


def run(name: str = "p", hits: Sequence[str] = (), **changes: Any) -> RunRecord:
    """A run that fails some of four scenes."""
    return hand_made(name, {scene: [CLEAN, HIT if scene in hits else CLEAN] for scene in SCENES}, **changes)


def hit(scene: str, run: int = 0, *, at_fault: bool = True) -> EpisodeRow:
    return row(scene, run, end="contact", contact=contact(at_fault))


def drives(folder: Path, *rows: EpisodeRow, name: str = "p", **changes: Any) -> DriveRecord:
    """Drives on the data of `run`."""
    data = {"name": "d", "version": "v", "fingerprint": "d adv"}
    scenes = list(dict.fromkeys(each.scene for each in rows))
    planner = {"name": name, "privileged": False, **changes.pop("planner", {})}
    return written(folder, *rows, planner=planner, data=data, scenes=scenes, scenes_in_split=4, **changes)


def loops(folder: Path, shares: Mapping[str, tuple[int, int]]) -> list[Any]:
    """Planners that fail so many of the first scenes in open and in closed loop."""
    return [
        compare_loops(
            drives(
                folder / name, *(hit(scene) if place < closed else row(scene) for place, scene in enumerate(SCENES))
            ),
            run(name, SCENES[:opened]),
        )
        for name, (opened, closed) in shares.items()
    ]


def test_rates_and_disagreements_are_over_the_scenes_that_both_have(tmp_path: Path) -> None:
    found = compare_loops(
        drives(tmp_path, hit("s1"), hit("s2", at_fault=False), row("s3")), run(hits=("s1", "s3", "s4"))
    )
    assert [each.scene for each in found.scenes] == ["s1", "s2", "s3"] and found.without == ()
    assert found.open_rate.value == pytest.approx(2 / 3) and found.open_rate.denominator == 3
    assert found.contact.value == pytest.approx(2 / 3) and found.at_fault.value == pytest.approx(1 / 3)
    assert [(each.scene, each.open_fails) for each in found.scenes if each.disagrees] == [("s2", False), ("s3", True)]
    assert found.scenes[1].first is not None and found.scenes[2].first is None


def test_of_several_runs_any_contact_fails_a_scene_and_rates_are_shares(tmp_path: Path) -> None:
    rows = [row("s1", 0), hit("s1", 1), hit("s1", 2, at_fault=False), row("s1", 3), row("s2", 0), row("s2", 1)]
    found = compare_loops(drives(tmp_path, *rows, runs=4), run())
    first, second = found.scenes
    assert (first.contact, first.at_fault, first.closed_fails) == (0.5, 0.25, True) and not second.closed_fails
    assert first.first is not None and first.first.run == 1
    assert found.contact.value == pytest.approx(0.25) and found.contact.denominator == 2


def test_what_failed_leaves_its_scene_out_unless_there_is_a_contact(tmp_path: Path) -> None:
    opened = hand_made("p", {"s1": [CLEAN], "s2": [CLEAN, FAILED], "s3": [HIT, FAILED], "s4": [CLEAN]})
    rows = [failed("s1"), row("s2"), row("s3"), hit("s4"), failed("s4").model_copy(update={"run": 1})]
    found = compare_loops(drives(tmp_path, *rows, runs=2), opened)
    assert [each.scene for each in found.scenes] == ["s3", "s4"] and found.without == ("s1", "s2")
    assert found.scenes[1].contact == 1.0
    nothing = compare_loops(drives(tmp_path / "none", failed("s1")), opened)
    assert nothing.scenes == () and nothing.open_rate.value is None


def test_a_run_stands_beside_drives_of_the_same_planner_and_data_alone(tmp_path: Path) -> None:
    driven = drives(tmp_path / "a", row("s1"))
    assert not is_stale(driven) and is_stale(drives(tmp_path / "old", row("s1"), scoring=999))
    assert find_run(driven, [run("other"), run()]) == run()
    others = (run("other"), run(split="val"), run(data="e"), run(weights="ab"), run(versions={"exact": 0}))
    assert all(find_run(driven, [other]) is None for other in others)
    weighted = drives(tmp_path / "b", row("s1"), planner={"weights_sha256": "ab"})
    assert find_run(weighted, [run(weights="ab")]) is not None
    assert find_run(drives(tmp_path / "c", row("s9")), [run()]) is None
    part, both = hand_made("p", {"s1": [CLEAN]}), drives(tmp_path / "d", row("s1"), row("s2"))
    assert find_run(both, [part, run()]) == run() == find_run(both, [run(), part])


def test_kendall_by_hand() -> None:
    assert kendall_tau(np.array([1.0, 2.0, 3.0]), np.array([2.0, 4.0, 9.0])) == 1.0
    assert kendall_tau(np.array([1.0, 2.0, 3.0]), np.array([3.0, 2.0, 1.0])) == -1.0
    # Five pairs in order and one not.
    assert kendall_tau(np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 3.0, 2.0, 4.0])) == pytest.approx(4 / 6)
    # One tie on one side: 2 pairs in order of 2 and 3 that are told apart.
    assert kendall_tau(np.array([1.0, 1.0, 2.0]), np.array([1.0, 2.0, 3.0])) == pytest.approx(2 / 6**0.5)
    assert kendall_tau(np.array([1.0, 1.0, 1.0]), np.array([1.0, 2.0, 3.0])) is None


def test_rank_correlation_says_of_how_many_and_ranks_at_fault_apart(tmp_path: Path) -> None:
    found = loops(tmp_path, {"a": (0, 1), "b": (1, 2), "c": (3, 4), "d": (2, 0)})
    correlation = compute_rank_correlation(found)
    # Of six pairs the three with d: (a, d), (b, d) and (c, d), of which the last alone is in order.
    assert correlation.tau == pytest.approx((4 - 2) / 6) and (correlation.planners, correlation.scenes) == (4, 4)
    assert compute_rank_correlation(found[:2]).tau is None and compute_rank_correlation(found[:2]).planners == 2
    assert compute_rank_correlation([]).planners == 0
    blamed = [
        compare_loops(
            drives(tmp_path / f"{name}-blamed", *(hit(each, at_fault=at < count) for at, each in enumerate(SCENES))),
            run(name, SCENES[:opened]),
        )
        for name, opened, count in (("a", 1, 3), ("b", 2, 2), ("c", 3, 1))
    ]
    assert compute_rank_correlation(blamed).tau is None and compute_rank_correlation(blamed, at_fault=True).tau == -1.0


def test_miniatures_rank_nothing_and_only_common_scenes_count(tmp_path: Path) -> None:
    found = loops(tmp_path, {"a": (0, 1), "b": (1, 2), "c": (3, 4)})
    small = compare_loops(drives(tmp_path / "m", row("s1"), planner={"miniature": True}), run())
    assert compute_rank_correlation([*found, small]) == compute_rank_correlation(found)
    part = compare_loops(drives(tmp_path / "p", row("s1"), row("s2")), run())
    assert compute_rank_correlation([*found, part]).scenes == 2
    elsewhere = compare_loops(drives(tmp_path / "e", row("s4")), run())
    assert compute_rank_correlation([*found, part, elsewhere]).tau is None
