"""Planners whose memory outlives a change of scene: the split is one unit of work, in the published order."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.can_bus import CanMessages
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.planning import EgoState, Observation, Plan, PlanFrame, SceneInfo
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.runs.scene_work import sort_as_published
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import AHEAD, Straight
from tests.hand_made import scene_on_straight_road


class Continuous(Straight):
    """Drives 0.1 m/s faster for each sample that it ever saw in its run."""

    name = "continuous"
    memory_crosses_scenes = True

    def __init__(self, fails_in: str = "") -> None:
        super().__init__()
        self.seen, self.scenes, self._fails_in = 0, [""], fails_in

    def begin_run(self) -> None:
        self.seen, self.scenes = 0, []

    def reset(self, scene: SceneInfo) -> None:
        self.scenes.append(scene.name)
        if scene.name == self._fails_in:
            raise KeyboardInterrupt

    def plan(self, observation: Observation) -> Plan:
        self.seen += 1
        return Plan(AHEAD * (1 + 0.025 * self.seen), PlanFrame.EGO)


def town(*, hours: tuple[int, ...] = (3, 1, 2)) -> FakeData:
    """Scenes whose names and times are in different orders."""
    scenes = {}
    for number, hour in enumerate(hours):
        made = scene_on_straight_road(name=f"scene-990{number}")
        later = made.timestamps_us + hour * 3_600_000_000
        scenes[made.name] = replace(made, timestamps_us=later, token=f"token{9 - number}")
    return FakeData(scenes)


def test_scenes_come_in_the_order_of_their_times_and_the_record_in_that_of_the_split(tmp_path: Path) -> None:
    data, planner = town(), Continuous()
    record = evaluate(data, "val", planner, tmp_path)
    assert planner.scenes == ["scene-9901", "scene-9902", "scene-9900"]
    assert [row.scene for row in record.rows] == sorted(row.scene for row in record.rows)
    first = {row.scene: row.plan.waypoints[0][0] for row in record.rows if row.plan and row.index == 0}
    assert first["scene-9901"] == pytest.approx(4.1)
    assert first["scene-9901"] < first["scene-9902"] < first["scene-9900"]
    assert record.run.planner.settings["memory_crosses_scenes"] is True


def test_variants_of_one_recording_come_in_the_order_of_their_tokens() -> None:
    assert sort_as_published(town(), ["scene-9900", "scene-9901", "scene-9902"])[0] == "scene-9901"
    same = town(hours=(1, 1, 2))
    assert sort_as_published(same, ["scene-9900", "scene-9901", "scene-9902"]) == (
        "scene-9902",
        "scene-9901",
        "scene-9900",
    )


def test_a_run_is_kept_as_a_whole_or_made_again_from_its_start(tmp_path: Path) -> None:
    data = town()
    whole = evaluate(data, "val", Continuous(), tmp_path / "whole")
    again = Continuous()
    assert evaluate(data, "val", again, tmp_path / "whole").rows == whole.rows
    assert again.seen == 0, "nothing had to be planned"
    with pytest.raises(KeyboardInterrupt):
        evaluate(data, "val", Continuous(fails_in="scene-9900"), tmp_path / "killed")
    used = Continuous()
    used.seen = 17
    goes_on = evaluate(data, "val", used, tmp_path / "killed")
    assert goes_on.rows == whole.rows, "the memory of an earlier run, or none, would move the plans"
    assert used.seen == len(whole.rows)


def test_a_scene_that_is_not_kept_makes_the_whole_split_anew(tmp_path: Path) -> None:
    data = town()
    record = evaluate(data, "val", Continuous(), tmp_path)
    (record.directory / "rows" / "scene-9902.json").unlink()
    again = Continuous()
    assert evaluate(data, "val", again, tmp_path).rows == record.rows
    assert again.seen == len(record.rows)


@pytest.mark.parametrize(
    ("settings", "option"),
    [
        (EvalSettings(workers=2), "--workers 2"),
        (EvalSettings(limit=1), "--limit"),
        (EvalSettings(scenes=("scene-9900",)), "--scenes"),
    ],
)
def test_a_part_of_the_split_and_several_processes_are_refused(
    settings: EvalSettings, option: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=f"continuous keeps state across scenes.*leave {option} out"):
        evaluate(town(), "val", Continuous(), tmp_path, settings)
    assert not list(tmp_path.iterdir())


class ReadsAfter(Straight):
    """Notes what it is given of the message after the sample."""

    name = "reads"
    reads_message_after = True

    def __init__(self) -> None:
        super().__init__()
        self.given: list[object] = []

    def plan(self, observation: Observation) -> Plan:
        self.given.append(observation.ego.can_motion_after)
        return super().plan(observation)


class ReadsNothing(ReadsAfter):
    """The same, but it does not say that it wants the message."""

    name = "reads-nothing"
    reads_message_after = False


class WithMessages(FakeData):
    """As `FakeData`, with a message after each sample."""

    def observations(self, name: str):  # type: ignore[no-untyped-def]
        for seen in super().observations(name):
            yield replace(seen, ego=replace(seen.ego, can_motion_after=np.arange(9.0)))


def test_the_message_after_the_sample_is_given_to_those_who_say_so_in_their_record(tmp_path: Path) -> None:
    data = WithMessages(town().scenes)
    told, untold = ReadsAfter(), ReadsNothing()
    record = evaluate(data, "val", told, tmp_path)
    evaluate(data, "val", untold, tmp_path)
    assert len(told.given) == len(record.rows) and all(each is not None for each in told.given)
    assert untold.given == [None] * len(record.rows)
    assert record.run.planner.settings == {"reads_message_after": True}
    assert build_planner_facts(untold).settings == {}


def test_the_message_after_a_time() -> None:
    messages = CanMessages(np.array([100, 200, 300], np.int64), np.array([[1.0], [2.0], [3.0]]))
    after = [float(messages.after_or_last(time)[0]) for time in (0, 99, 100, 150, 200, 300, 10**9)]
    assert after == [1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 3.0], "the first later one; the last where none is later"
    assert EgoState.__dataclass_fields__["can_motion_after"].default is None
