"""One script for each scene, from which the player draws, and the pictures that it shows.

A script holds an object with these members; lengths are packed (`leaderboard.site.packing`) in centimetres and angles
in milliradians, in the sheet's local frame, unless said otherwise:

* ``key, data, split, scene, manoeuvre, description, hasSheet, adversarial`` (whether its records are of a split with
  adversaries), ``page`` (`leaderboard.site.scene_index`);
* ``frames``: seconds from the first frame, one a frame of the player (12 Hz with a sheet, one a sample without);
* ``samples``: ``{frame, t, command}`` of each sample, ``command`` 0 right, 1 left, 2 straight, null if no planner ran;
* ``body``: ``{length, width, ahead}`` of the ego as protocols see it, ``ahead`` of the lidar origin, metres;
* ``ego``: ``{x, y, yaw}`` of the rear axle and ``{length, width, ahead}`` of the body, metres; null without a sheet;
* ``agents``: ``{id, category, size, adversary, first, count, x, y, yaw}``, ``size`` in metres;
* ``road``: ``{drivable, crossings, walkways, carparks}`` as polygons of rings, ``dividers`` as ``{paint, points}``;
* ``recorded``: without a sheet, for each sample the recorded way of the lidar (x, y in turn, centimetres) in the ego's
  frame at the sample, which then is the local frame of that sample;
* ``cameras, pictures, media, edges``: cells, frames with a picture, their folder, and for each such frame and number
  of a camera the edges of adversaries' boxes (four whole pixels each);
* ``protocols``: names; ``models``: `leaderboard.site.scene_plans.build_planner_samples` of each planner, in the order
  of tables; ``shown``: for each protocol who is shown at first; ``closest``: when an adversary is closest to the
  recorded ego, seconds, null without one; ``apart``: `leaderboard.site.scene_plans.list_distances`.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from benchmark.constants import EGO_BOX_FROM_LIDAR_M, EGO_LENGTH_M, EGO_WIDTH_M
from benchmark.errors import InputError
from benchmark.geometry import Floats, box_gap
from benchmark.metrics.effect import attributes_contacts
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import is_baseline
from benchmark.records.scene_pages import (
    PageAgent,
    PageMap,
    Polygon,
    ScenePage,
    ScenePages,
    StoredScenePage,
    picture_name,
)
from benchmark.report.birdseye import BirdseyeScene
from benchmark.report.palette import ON_DARK, ON_LIGHT, GroundColours
from benchmark.report.placement import agent_box, ego_box
from benchmark.waypoints import points_in_ego
from leaderboard.frame.rows import sort_for_tables
from leaderboard.site.packing import CENTIMETRE, encode_script, pack_path, pack_poses
from leaderboard.site.scene_facts import SceneName, scene_key
from leaderboard.site.scene_plans import build_planner_samples, list_differing, list_distances
from leaderboard.site.table_entries import sort_protocols

_MICROSECONDS: Final = 1e6
_SCENES: Final = "window.CHALLENGER_SCENES = window.CHALLENGER_SCENES || {}"
THUMBNAIL_PX: Final = 320
THUMBNAIL_EXTENT_M: Final = 20.0
_QUALITY: Final = 80


@dataclass(frozen=True, slots=True)
class _PlannerRun:
    """One planner in one scene; `rows` are by sample token."""

    record: RunRecord
    rows: Mapping[str, SampleRow]


def build_scene_files(
    sheets: ScenePages, records: Sequence[RunRecord], pages: Mapping[str, Any] | None = None
) -> dict[str, bytes | Path]:
    """Files of every scene that a record or a sheet names; a path as value means a copy of that file.

    ``data/scenes/<key>.js``, ``media/<key>/cameras/<frame>.webp``, ``media/<key>/thumb.webp`` and
    ``media/<key>/thumb-dark.webp`` below the site's folder. `pages` are members of the scripts by key.
    """
    ran = _group_by_scene(records)
    files: dict[str, bytes | Path] = {}
    for sheet in sheets.scenes.values():
        _require_equal_lengths(sheet)
    for name in sorted({*ran, *sheets.scenes}):
        key, stored = scene_key(name), sheets.scenes.get(name)
        # Rows of one scene at a time: those of all would fill memory.
        here = [
            _PlannerRun(record, {row.sample_token: row for row in record.rows_of(name[2])})
            for record in ran.get(name, [])
        ]
        data = _build_scene(name, key, stored, here) | {"page": (pages or {}).get(key)}
        files[f"data/scenes/{key}.js"] = encode_script(f'({_SCENES})["{key}"]', data)
        if stored is not None:
            files |= {
                f"media/{key}/{picture_name(frame)}": stored.picture_path(frame) for frame in stored.sheet.pictures
            }
            if stored.sheet.timestamps_us:
                files[f"media/{key}/thumb.webp"] = draw_thumbnail(stored.sheet)
                files[f"media/{key}/thumb-dark.webp"] = draw_thumbnail(stored.sheet, ON_DARK)
    return files


def _require_equal_lengths(stored: StoredScenePage) -> None:
    """Lists that belong together must be of one length; a schema cannot say so."""
    sheet, frames = stored.sheet, len(stored.sheet.timestamps_us)
    is_whole = all(len(values) == frames for values in (sheet.ego.x_m, sheet.ego.y_m, sheet.ego.yaw_rad))
    is_whole &= len(sheet.sample_tokens) == len(sheet.keyframes) and all(0 <= at < frames for at in sheet.keyframes)
    for agent in sheet.agents:
        is_whole &= len(agent.x_m) == len(agent.y_m) == len(agent.yaw_rad) <= frames - agent.first
    if not is_whole:
        raise InputError(
            f"the sheet of {sheet.scene} in {stored.directory} has lists of different lengths; run challenger-bench "
            "sheets again"
        )


def _group_by_scene(records: Sequence[RunRecord]) -> dict[SceneName, list[RunRecord]]:
    records_by_scene: dict[SceneName, list[RunRecord]] = defaultdict(list)
    for record in sort_for_tables(records):
        for scene in dict.fromkeys([*record.run.scenes, *record.columns.places_of_scenes]):
            records_by_scene[record.run.data.name, record.run.split, scene].append(record)
    return records_by_scene


def _build_scene(
    name: SceneName, key: str, stored: StoredScenePage | None, ran: Sequence[_PlannerRun]
) -> dict[str, Any]:
    data_name, split, scene = name
    protocols = sort_protocols(protocol for planner_run in ran for protocol in planner_run.record.run.protocols)
    facts = {
        "key": key,
        "data": data_name,
        "split": split,
        "scene": scene,
        "hasSheet": stored is not None,
        "adversarial": any(attributes_contacts(planner_run.record) for planner_run in ran),
        "protocols": protocols,
        "body": {"length": EGO_LENGTH_M, "width": EGO_WIDTH_M, "ahead": EGO_BOX_FROM_LIDAR_M},
    }
    drawn = _build_plain_data(name, ran) if stored is None else _build_page_data(stored.sheet, key)
    tokens, poses = _list_plain_samples(ran) if stored is None else _list_page_samples(stored, ran)
    agents = {agent.id: number for number, agent in enumerate(stored.sheet.agents)} if stored is not None else {}
    seconds, frames = drawn["frames"], range(len(tokens)) if stored is None else stored.sheet.keyframes
    commands = {token: row.command for planner_run in ran for token, row in planner_run.rows.items()}
    samples = [
        {"frame": frame, "t": seconds[frame], "command": commands.get(token)}
        for token, frame in zip(tokens, frames, strict=True)
    ]
    times = [sample["t"] for sample in samples]
    models = [
        build_planner_samples(planner_run.record, planner_run.rows, tokens, poses, times, protocols, agents)
        for planner_run in ran
    ]
    baselines = {each.record.planner for each in ran if is_baseline(each.record.run.planner)}
    closest = None
    if stored is not None and any(agent.adversary for agent in stored.sheet.agents):
        closest = seconds[find_closest_frame(stored.sheet)]
    return {
        **facts,
        **drawn,
        "samples": samples,
        "models": models,
        "shown": [list_differing(models, place, baselines) for place in range(len(protocols))],
        "closest": closest,
        "apart": list_distances(models, len(samples)),
    }


def _build_page_data(sheet: ScenePage, key: str) -> dict[str, Any]:
    return {
        "manoeuvre": sheet.manoeuvre,
        "description": sheet.description,
        "frames": _to_seconds(sheet.timestamps_us),
        "ego": pack_poses(sheet.ego.x_m, sheet.ego.y_m, sheet.ego.yaw_rad) | build_body(sheet),
        "agents": [build_agent(agent) for agent in sheet.agents],
        "road": _build_road(sheet.road),
        "cameras": [camera.model_dump() for camera in sheet.cameras],
        "pictures": list(sheet.pictures),
        "media": f"media/{key}/cameras/",
        "edges": _build_edges(sheet),
    }


def _build_plain_data(name: SceneName, ran: Sequence[_PlannerRun]) -> dict[str, Any]:
    """Each sample by itself in the ego's frame; its poses in the world are in no record."""
    rows = _sort_rows(ran)
    facts = [planner_run.record.run.scene_facts.get(name[2]) for planner_run in ran]
    return {
        "manoeuvre": next((of_scene.manoeuvre for of_scene in facts if of_scene is not None), None),
        "description": "",
        "frames": _to_seconds([row.timestamp_us for row in rows]),
        "ego": None,
        "agents": [],
        "road": _build_road(PageMap()),
        "recorded": [_pack_recorded_path(row) for row in rows],
        "cameras": [],
        "pictures": [],
        "media": None,
        "edges": {},
    }


def _list_page_samples(stored: StoredScenePage, ran: Sequence[_PlannerRun]) -> tuple[Sequence[str], Floats]:
    sheet = stored.sheet
    for planner_run in ran:
        unknown = next((token for token in planner_run.rows if token not in sheet.sample_tokens), None)
        if unknown is not None:
            raise InputError(
                f"{planner_run.record.directory} has sample {unknown} of {sheet.scene}, which the scene's sheet in "
                f"{stored.directory} lacks; run challenger-bench sheets again"
            )
    ego = np.column_stack([sheet.ego.x_m, sheet.ego.y_m, sheet.ego.yaw_rad])
    return sheet.sample_tokens, ego[list(sheet.keyframes)]


def _list_plain_samples(ran: Sequence[_PlannerRun]) -> tuple[Sequence[str], Floats]:
    tokens = [row.sample_token for row in _sort_rows(ran)]
    return tokens, np.zeros((len(tokens), 3))


def _sort_rows(ran: Sequence[_PlannerRun]) -> list[SampleRow]:
    """One row for each sample of any planner, by time."""
    by_token = {token: row for planner_run in ran for token, row in planner_run.rows.items()}
    return sorted(by_token.values(), key=lambda row: (row.timestamp_us, row.index))


def _pack_recorded_path(row: SampleRow) -> list[int]:
    known = [pose[:2] for pose in row.recorded_future if pose is not None]
    return pack_path(points_in_ego(np.array(known).reshape(-1, 2), row.lidar_ahead_m), CENTIMETRE)


def _to_seconds(timestamps_us: Sequence[int]) -> list[float]:
    return [round((time - timestamps_us[0]) / _MICROSECONDS, 3) for time in timestamps_us]


def build_agent(agent: PageAgent) -> dict[str, Any]:
    """A member of ``agents``."""
    return {
        "id": agent.id,
        "category": agent.category,
        "size": [round(metres, 2) for metres in agent.size_m],
        "adversary": agent.adversary,
        "first": agent.first,
        "count": len(agent.x_m),
        **pack_poses(agent.x_m, agent.y_m, agent.yaw_rad),
    }


def build_body(sheet: ScenePage) -> dict[str, float]:
    """The ego's rectangle, of which ``ahead`` is where the middle is."""
    return {"length": sheet.ego.length_m, "width": sheet.ego.width_m, "ahead": sheet.ego.centre_ahead_m}


def _build_road(road: PageMap) -> dict[str, Any]:
    def rings(polygons: Sequence[Polygon]) -> list[list[list[int]]]:
        return [[pack_path(ring, CENTIMETRE) for ring in polygon] for polygon in polygons]

    areas = {name: rings(getattr(road, name)) for name in ("drivable", "crossings", "walkways", "carparks")}
    lines = [{"paint": line.paint, "points": pack_path(line.points, CENTIMETRE)} for line in road.dividers]
    return {**areas, "dividers": lines}


def _build_edges(sheet: ScenePage) -> dict[str, dict[str, list[int]]]:
    number = {camera.name: str(index) for index, camera in enumerate(sheet.cameras)}
    return {
        frame: {
            number[camera]: [round(pixel) for segment in segments for pixel in segment]
            for camera, segments in by_camera.items()
            if camera in number
        }
        for frame, by_camera in sheet.adversary_edges.items()
    }


def draw_thumbnail(sheet: ScenePage, colours: GroundColours = ON_LIGHT) -> bytes:
    """A WebP picture of 320 x 320 pixels: the scene, which has frames, from above in its `find_closest_frame`."""
    image, _ = BirdseyeScene(sheet, colours).draw(
        find_closest_frame(sheet), width_px=THUMBNAIL_PX, height_px=THUMBNAIL_PX, extent_m=THUMBNAIL_EXTENT_M
    )
    succeeded, encoded = cv2.imencode(".webp", image[:, :, ::-1], [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    if not succeeded:
        raise InputError(f"OpenCV cannot write the WebP picture of {sheet.scene}; install a build of it that has WebP")
    return encoded.tobytes()


def find_closest_frame(sheet: ScenePage) -> int:
    """First frame in which an adversary's box is closest to the recorded ego's; the middle one without adversaries."""
    adversaries = [agent for agent in sheet.agents if agent.adversary]
    best = (np.inf, len(sheet.timestamps_us) // 2)
    for frame in range(len(sheet.timestamps_us)):
        boxes = [box for box in (agent_box(agent, frame) for agent in adversaries) if box is not None]
        if boxes:
            best = min(best, (float(box_gap(ego_box(sheet, frame), np.array(boxes)).min()), frame))
    return best[1]
