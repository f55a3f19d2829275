"""Sheets of drives: the world as it was driven, from the stored plans; what films of drives are made from."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.closed_loop.episodes import Episode
from benchmark.closed_loop.observation_builder import NoSensor, Sensor
from benchmark.closed_loop.route import Route, build_driven_scene
from benchmark.closed_loop.simulation_state import SPEED, SimulatorBackend
from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import file_sha256, write_bytes
from benchmark.planning import CameraView, Observation, Plan
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord
from benchmark.records.scene_pages import PageCamera, ScenePage, StoredScenePage, picture_name
from benchmark.records.search_trace import read_search_trace
from benchmark.report.episode_page import EpisodePage, compute_speeds, mark_from_departure
from benchmark.report.overlays import CollisionMark, find_shared_point
from benchmark.report.placement import ego_pose, frame_seconds, place_waypoints
from benchmark.runs.redriving import StoredPlans, redrive_with_sensor
from benchmark.scene import Scene
from benchmark.scene_pages.page_building import build_page_to_draw
from benchmark.scene_pages.page_pictures import draw_mosaic, lay_out_cameras, project_adversary_edges

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

CELL_WIDTH_PX: Final = 448


class StoredPlansWithViews(StoredPlans):
    """Stored plans, and what cameras saw when each was asked for."""

    def __init__(self, row: EpisodeRow) -> None:
        super().__init__(row)
        self.seen: list[dict[str, CameraView]] = []

    def plan(self, observation: Observation) -> Plan:
        """The next plan; the views are kept."""
        self.seen.append(observation.views)
        return super().plan(observation)


def write_episode_page(
    folder: Path, data: "DataSet", record: DriveRecord, row: EpisodeRow, maker: SimulatorBackend, sensor: Sensor | None
) -> EpisodePage:
    """Drive stored plans again and write their sheet, with pictures in a folder.

    ``sensor`` drew for the planner; ``None`` where none did, or not the present one. Another data set, or plans that
    lead elsewhere than they did, are refused.
    """
    if data.fingerprint() != record.facts.data.fingerprint:
        raise InputError(
            f"{record.directory} used other data than {data.root} now holds (the fingerprints differ); run "
            "challenger-bench drive again"
        )
    scene, plans = data.scene(row.scene), StoredPlansWithViews(row)
    episode = redrive_with_sensor(maker, sensor or NoSensor(), scene, data, row, plans)
    driven = _with_its_adversary(build_driven_scene(scene, Route.of(scene), episode.motion), row)
    sheet = build_page_to_draw(driven).model_copy(update={"data": record.facts.data, "split": record.facts.split})
    agents = tuple(mark_from_departure(sheet.agents, row.window, frame_seconds(sheet)))
    sheet = sheet.model_copy(update={"agents": agents})
    first = len(driven.timestamps_us) - len(episode.motion.times_us)
    asked_at = [first + int(tick) for tick in episode.motion.ticks]
    if sensor is not None:
        departs_s = None if row.window is None else row.window.departs_s
        marked = [at for at in asked_at if departs_s is None or driven.seconds[at] >= departs_s - 1e-3]
        sheet = _with_pictures(folder, driven, sheet, asked_at, plans.seen, marked)
    # One plan per planned instant: a failed drive has an instant without a plan.
    placed_plans = {
        frame: place_waypoints(
            np.array(plan.waypoints, np.float64),
            plan.frame,
            float(scene.lidar.translation[0]),
            ego_pose(sheet, frame),
        )
        for frame, plan in zip(asked_at, row.plans, strict=False)
    }
    recorded, seconds = _find_recorded_path(scene, sheet)
    # Before the drive starts, the driven ego follows the recording.
    speed = np.interp(np.arange(first), np.arange(len(seconds)), compute_speeds(recorded, seconds))
    return EpisodePage(
        stored=StoredScenePage(folder, sheet, None),
        row=row,
        begins=asked_at[min(episode.primed, len(asked_at)) - 1],
        plans=placed_plans,
        recorded=recorded,
        recorded_speed=compute_speeds(recorded, seconds),
        recorded_seconds=seconds,
        speed=np.concatenate([speed, episode.motion.ego[:, SPEED]]),
        contact=_find_collision(episode, sheet),
        considered=read_search_trace(record.directory, row) or (),
    )


def _with_its_adversary(driven: Scene, row: EpisodeRow) -> Scene:
    """The scene with who drove adversarially among its adversaries: in a recording it is one of the others."""
    names = [] if row.adversary is None else [row.adversary.uuid]
    names += [] if row.window is None else row.window.adversaries
    more = tuple(name for name in names if name not in driven.adversaries)
    return replace(driven, adversaries=(*driven.adversaries, *more)) if more else driven


def _with_pictures(
    folder: Path,
    driven: Scene,
    sheet: ScenePage,
    frames: list[int],
    views_of_ticks: list[dict[str, CameraView]],
    marked: list[int],
) -> ScenePage:
    """Write what the planner saw at each instant; returns the sheet that names it, adversaries at ``marked`` frames."""
    cells: tuple[PageCamera, ...] = lay_out_cameras(
        {name: view.camera for name, view in views_of_ticks[0].items()}, CELL_WIDTH_PX
    )
    edges, files = {}, {}
    # The last instant of a drive has no plan.
    for frame, views in zip(frames, views_of_ticks, strict=False):
        path = picture_name(frame)
        write_bytes(folder / path, draw_mosaic(cells, views), durable=False)
        files[path] = file_sha256(folder / path)
        edges_of_frame = project_adversary_edges(driven, cells, views)
        if edges_of_frame and frame in marked:
            edges[str(frame)] = edges_of_frame
    pictured = tuple(frames[: len(views_of_ticks)])
    return sheet.model_copy(update={"cameras": cells, "pictures": pictured, "adversary_edges": edges, "files": files})


def _find_recorded_path(scene: Scene, sheet: ScenePage) -> tuple[Floats, Floats]:
    """Centres of the recorded ego's body in the sheet's metres, and seconds after the sheet's first frame."""
    pose = scene.ego.pose
    ahead = EGO_CENTER_FROM_REAR_AXLE_M * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    seconds = (scene.timestamps_us - sheet.timestamps_us[0]) * 1e-6
    return np.asarray(pose[:, :2] + ahead - np.array(sheet.origin_m)), np.asarray(seconds, np.float64)


def _find_collision(episode: Episode, sheet: ScenePage) -> CollisionMark | None:
    if episode.touch is None:
        return None
    moved = np.array([*sheet.origin_m, 0.0, 0.0, 0.0])
    ego, other = episode.touch.ego - moved, episode.touch.other - moved
    seconds = (episode.touch.time_us - sheet.timestamps_us[0]) * 1e-6
    return CollisionMark(float(seconds), ego, other, find_shared_point(ego, other))
