"""Sheets of drives: the world as it was driven, drawn again from stored plans alone."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from adapters.planners.log_replay import LogReplay
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.observation_builder import Sensor
from benchmark.errors import InputError
from benchmark.geometry import box_gap
from benchmark.planning import CameraView
from benchmark.records.drives import DriveRecord
from benchmark.report.episode_page import EpisodePage
from benchmark.report.palette import choose_planner_style
from benchmark.runs.driving import DriveSettings, drive_split
from benchmark.runs.episode_pages import write_episode_page
from benchmark.scene import Camera, Scene
from tests.benchmark.planners import Failing, Straight
from tests.benchmark.runs.test_driving import town

STYLE = choose_planner_style(0)


def driven(out: Path, planner: Any, agents: str = "replay") -> DriveRecord:
    return drive_split(town(), "val", planner, out, DriveSettings("default", DefaultBackend(agents), agents=agents))


def shown(folder: Path, record: DriveRecord, place: int, sensor: Sensor | None = None) -> EpisodePage:
    maker = DefaultBackend(record.facts.measured.agents)
    return write_episode_page(folder, town(), record, record.rows[place], maker, sensor)


CAMERA = Camera("CAM_FRONT", np.eye(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), 64, 36)


@dataclass(frozen=True)
class Clock:
    """A sensor whose pictures are as bright as the scene is old, and that is its own look."""

    name: str = "clock"
    cameras: tuple[Camera, ...] = (CAMERA,)

    @property
    def facts(self) -> Mapping[str, Any]:
        return {}

    def look(self, scene: Scene) -> "Clock":
        return self

    def views(self, driven: Scene) -> dict[str, CameraView]:
        halves = round((int(driven.timestamps_us[-1]) - int(driven.timestamps_us[0])) / 500_000)
        picture = np.full((36, 64, 3), 10 * halves, np.uint8)
        return {"CAM_FRONT": CameraView(CAMERA, Path("x"), 0, np.eye(4), load=partial(picture.copy))}


def test_the_sheet_is_the_driven_world(tmp_path: Path) -> None:
    record = driven(tmp_path / "out", Straight())
    free, hit = (shown(tmp_path, record, place) for place in range(2))
    row, sheet = hit.row, hit.stored.sheet
    ticks = sorted(hit.plans)
    assert len(ticks) == len(row.plans) and hit.begins == ticks[row.primed - 1]
    for frame, state in zip(ticks, row.ticks.ego):
        place = np.array([sheet.ego.x_m[frame], sheet.ego.y_m[frame]]) + sheet.origin_m
        np.testing.assert_allclose(place, state[:2], atol=0.006)
        assert hit.speed[frame] == pytest.approx(state[3], abs=1e-5)
    assert len(hit.speed) == len(sheet.timestamps_us) and not sheet.pictures
    assert free.contact is None and (sheet.data.name, sheet.split) == ("fake", "val")
    assert hit.recorded.shape == (len(town().scene(row.scene).timestamps_us), 2)


def test_the_contact_is_where_both_touch(tmp_path: Path) -> None:
    hit = shown(tmp_path, driven(tmp_path / "out", Straight()), 1)
    assert hit.contact is not None and hit.contact.other is not None and hit.row.contact is not None
    assert box_gap(hit.contact.ego, hit.contact.other) == pytest.approx(0.0, abs=1e-6)
    began = hit.seconds[hit.begins]
    assert hit.contact.seconds == pytest.approx(began + hit.row.contact.seconds, abs=1e-5)
    last = len(hit.seconds) - 1
    overlay = hit.plan_at(last, "p", STYLE)
    assert overlay is not None and overlay.contact is not None
    assert overlay.contact.seconds - overlay.age_s == pytest.approx(hit.contact.seconds - hit.seconds[last])
    early = int(np.searchsorted(hit.seconds, hit.contact.seconds - 3.2))
    before = hit.plan_at(early, "p", STYLE)
    assert before is not None and before.contact is None and before.plan is not None


def test_a_recorded_future_is_driven_along_the_recorded_path(tmp_path: Path) -> None:
    found = shown(tmp_path, driven(tmp_path / "out", LogReplay()), 0)
    sheet = found.stored.sheet
    ahead = sheet.ego.centre_ahead_m
    yaw = np.array(sheet.ego.yaw_rad)
    body = np.column_stack([sheet.ego.x_m + ahead * np.cos(yaw), sheet.ego.y_m + ahead * np.sin(yaw)])
    aside = np.hypot(*(body[:, None] - found.path().points[None]).transpose(2, 0, 1)).min(axis=1)
    # Recorded places are less than a metre apart.
    assert aside.max() < 0.6
    assert len(found.plans) == len(found.row.plans) and all(plan is not None for plan in found.plans.values())


def test_pictures_are_what_the_planner_saw(tmp_path: Path) -> None:
    record = driven(tmp_path / "out", Straight())
    found = shown(tmp_path / "pictures", record, 1, Clock())
    sheet = found.stored.sheet
    assert sheet.pictures == tuple(sorted(found.plans)) and [cell.name for cell in sheet.cameras] == ["CAM_FRONT"]
    for halves, frame in enumerate(sheet.pictures[:5]):
        picture = cv2.imread(str(found.stored.picture_path(frame)))
        assert picture is not None and abs(float(picture.mean()) - 10 * halves) < 3.0


def test_agents_that_answered_stand_where_they_went(tmp_path: Path) -> None:
    replayed, answering = (
        shown(tmp_path / name, driven(tmp_path / "out" / name, Straight(), name), 1) for name in ("replay", "idm")
    )
    assert answering.row.ticks.ego == driven(tmp_path / "again", Straight(), "idm").rows[1].ticks.ego
    tracks = [each.stored.sheet.agents for each in (replayed, answering)]
    assert [agent.id for agent in tracks[0]] == [agent.id for agent in tracks[1]]
    assert any(one.x_m[-1] != other.x_m[-1] for one, other in zip(*tracks))


def test_a_failed_drive_ends_where_it_failed(tmp_path: Path) -> None:
    record = driven(tmp_path / "out", Failing())
    place = next(place for place, row in enumerate(record.rows) if row.status == "failed")
    found = shown(tmp_path, record, place)
    assert found.row.failure is not None and found.contact is None
    assert len(found.plans) == len(found.row.plans)


def test_other_data_and_other_ways_are_refused(tmp_path: Path) -> None:
    record = driven(tmp_path / "out", Straight())
    other = replace(
        record,
        facts=record.facts.model_copy(update={"data": record.facts.data.model_copy(update={"fingerprint": "e"})}),
    )
    with pytest.raises(InputError, match="used other data than"):
        shown(tmp_path, other, 0)
    row = record.rows[0]
    states = [[state[0], 0.0, *state[2:]] for state in row.ticks.ego]
    moved = row.model_copy(update={"ticks": row.ticks.model_copy(update={"ego": states})})
    with pytest.raises(InputError, match="give another"):
        write_episode_page(tmp_path, town(), record, moved, DefaultBackend(), None)
