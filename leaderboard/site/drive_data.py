"""Drives for the player: one script for each, and their entries in the index.

A drive's script has members of a scene's (`leaderboard.site.scene_data`) that take the place of those of its scene,
whose key is ``base``: ``frames`` to the drive's end, ``ego`` as driven, ``samples`` (the planning instants), ``models``
(who drove, with the plan of each instant), no protocols and no pictures; ``agents`` is empty if the tracks of
others are unknown, and has all of the scene, each while present, if a vehicle that touched the ego was removed. Also:

* ``recordedPath``: x, y in turn of the recorded body, centimetres as steps;
* ``contact``: ``{t, x, y}`` seconds and metres of the contact that ended it, or null;
* ``moved``: where there was an adversary that answers, its track, as ``agents`` has it; it takes the place of its own;
* ``considered``: where it was kept, what that adversary considered (`build_search_trace`);
* ``opens`` and ``strip``: of a drive in a window around an encounter, when it begins, and the elements of a strip below
  the time line: time to collision of each half second, and who was touched. ``agents`` are those that keep their
  tracks, each adversary as two: an ordinary vehicle until it departs.

The ego is between the stored states, half a second apart, where a cubic through their places and speeds leads.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.constants import LIDAR_FROM_REAR_AXLE_M
from benchmark.geometry import Floats
from benchmark.machine.storage import content_key
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord
from benchmark.records.scene_pages import PageAgent, ScenePage, ScenePages
from benchmark.records.search_trace import SearchTraceFrame, read_search_trace
from benchmark.report.cells import format_number
from benchmark.report.episode_page import list_strip_steps, list_touches, mark_from_departure
from benchmark.report.fault_words import describe_fault
from benchmark.report.overlays import find_shared_point, rank_candidates
from benchmark.report.placement import agent_box, agent_box_at, ego_box, ego_pose, frame_seconds, place_waypoints
from leaderboard.frame.drives import group_comparable_drives
from leaderboard.frame.rows import name_cell
from leaderboard.site.packing import (
    CENTIMETRE,
    DECIMETRE,
    MILLIRADIAN,
    encode_script,
    pack_path,
    pack_poses,
    pack_series,
)
from leaderboard.site.scene_data import build_agent, build_body
from leaderboard.site.scene_facts import scene_key
from leaderboard.site.scene_plans import ERROR_CHARACTERS

_SCENES: Final = "window.CHALLENGER_SCENES = window.CHALLENGER_SCENES || {}"
_YAW, _SPEED = 2, 3
_LATE_S: Final = 1e-3
_NOWHERE: Final = np.empty((0, 1, 2))


@dataclass(frozen=True, slots=True)
class _NamedDrive:
    record: DriveRecord
    name: str
    row: EpisodeRow

    @property
    def key(self) -> str:
        """Key in addresses and file names."""
        of = [] if self.row.window is None else [self.row.window.of]
        return content_key("drive", self.record.content_id, self.row.scene, self.row.family, self.row.run, *of)[:16]

    @property
    def scene(self) -> tuple[str, str, str]:
        """Data set, split, scene."""
        return self.record.facts.data.name, self.record.facts.split, self.row.scene

    @property
    def shows_all_agents(self) -> bool:
        """Whether other road users follow the recording: records hold only positions of ego and adversary."""
        measured = self.record.facts.measured
        return measured.engine == "default" and measured.agents_facts.get("others", measured.agents) == "replay"


def build_drive_files(drives: Sequence[DriveRecord], sheets: ScenePages) -> dict[str, bytes]:
    """Scripts of the drives whose scene has a sheet of the same content: ``data/scenes/<key>.js`` below the site."""
    files = {}
    for named_drive in _list_drives(drives):
        if _has_scene_page(named_drive, sheets):
            drive = _build_drive(named_drive, sheets.scenes[named_drive.scene].sheet)
            files[f"data/scenes/{named_drive.key}.js"] = encode_script(f'({_SCENES})["{named_drive.key}"]', drive)
    return files


def build_drive_index(drives: Sequence[DriveRecord], sheets: ScenePages) -> list[dict[str, Any]]:
    """Entries of drives for pages.

    For each ``key`` (null without a sheet), ``scene`` (the scene's key), ``planner`` (with its marks), and in words
    ``measured``, ``outcome`` and ``note`` (what its page shows).
    """
    entries = []
    for named_drive in _list_drives(drives):
        facts, row = named_drive.record.facts, named_drive.row
        family = f", {row.family}" if row.family else ""
        run = f", run {row.run}" if facts.runs > 1 else ""
        entries.append(
            {
                "key": named_drive.key if _has_scene_page(named_drive, sheets) else None,
                "scene": scene_key(named_drive.scene),
                "planner": name_cell(named_drive.name, facts.planner).text,
                "measured": f"{facts.measured.world}{family}, sensor {facts.measured.sensor}{run}",
                "outcome": _describe_outcome(named_drive, sheets),
                "note": _describe_view(named_drive, sheets),
            }
        )
    return entries


def _describe_outcome(named_drive: _NamedDrive, sheets: ScenePages) -> str:
    """What became of a drive; the time of a contact is that of the scene, where a sheet says when it begins."""
    row = named_drive.row
    if row.end == "failed":
        return f"failed ({row.failure.reason if row.failure is not None else 'no reason given'}): nothing is scored"
    if row.contact is None:
        return "no contact"
    contact = row.contact
    whom = f"{contact.category}{', the adversary' if contact.adversary else ''}"
    when = f"after {format_number(contact.seconds, 1)} s of driving"
    if _has_scene_page(named_drive, sheets):
        ticks = _seconds_of_ticks(row, sheets.scenes[named_drive.scene].sheet)
        when = f"at {format_number(float(ticks[row.primed - 1]) + contact.seconds, 1)} s"
    return f"contact {when} with {whom}, {describe_fault(contact)}"


def _seconds_of_ticks(row: EpisodeRow, sheet: ScenePage) -> Floats:
    return (np.array(row.ticks.time_us, np.int64) - sheet.timestamps_us[0]) * 1e-6


def _describe_view(named_drive: _NamedDrive, sheets: ScenePages) -> str:
    moved, window = _adversary_is_shown(named_drive, sheets), named_drive.row.window
    who = "the adversary as it drove"
    if window is not None:
        is_made = window.of == named_drive.row.scene
        who = "the adversary" if is_made else f"the vehicle that becomes the adversary of {window.of}"
        who += "" if window.departs_s is None else f", from {format_number(window.departs_s, 1)} s on"
        who += ", when it departs from its recording" if is_made and window.departs_s is not None else ""
    others = (
        "The others are where the recording has them."
        if named_drive.shows_all_agents
        else f"Only the ego {'and the adversary are' if moved else 'is'} shown as driven: the record does not hold "
        "where the others went. challenger-bench film --drives shows everybody."
    )
    return (
        "Green is the driven ego, the pale dashes are the recorded path, the line with marks is the plan of each "
        f"instant. {f'Orange is {who}. ' if moved else ''}{others}"
    )


def _list_drives(drives: Sequence[DriveRecord]) -> Iterator[_NamedDrive]:
    """Every drive once, in the order of the tables."""
    listed_ids = set()
    for world in group_comparable_drives(drives):
        for table_row in world.rows:
            if table_row.record.content_id not in listed_ids:
                listed_ids.add(table_row.record.content_id)
                yield from (_NamedDrive(table_row.record, table_row.name, row) for row in table_row.record.rows)


def _has_scene_page(named_drive: _NamedDrive, sheets: ScenePages) -> bool:
    stored = sheets.scenes.get(named_drive.scene)
    return stored is not None and stored.sheet.data.fingerprint == named_drive.record.facts.data.fingerprint


def _adversary_is_shown(named_drive: _NamedDrive, sheets: ScenePages) -> bool:
    if not _has_scene_page(named_drive, sheets):
        return False
    sheet, window = sheets.scenes[named_drive.scene].sheet, named_drive.row.window
    if window is not None:
        return any(agent.id in window.adversaries for agent in sheet.agents)
    return build_driven_adversary(sheet, named_drive.row) is not None


def _build_drive(named_drive: _NamedDrive, sheet: ScenePage) -> dict[str, Any]:
    row = named_drive.row
    ticks = _seconds_of_ticks(row, sheet)
    states = np.array(row.ticks.ego, np.float64)
    states[:, :2] -= sheet.origin_m
    adversary = build_driven_adversary(sheet, row)
    contact = _build_contact(named_drive, sheet, adversary, ticks, states)
    end = ticks[-1] if contact is None else contact["t"]
    seconds = frame_seconds(sheet)
    seconds = seconds[: max(int(np.searchsorted(seconds, end + _LATE_S)), 1)]
    recorded = np.array([ego_pose(sheet, frame) for frame in range(len(seconds))])
    pose = np.where((seconds < ticks[0])[:, None], recorded, interpolate_poses(seconds, ticks, states))
    data = {
        "base": scene_key(named_drive.scene),
        "key": named_drive.key,
        "frames": np.round(seconds, 3).tolist(),
        "ego": pack_poses(*pose.T.tolist()) | build_body(sheet),
        "recordedPath": pack_path(
            np.array([ego_box(sheet, frame)[:2] for frame in range(len(sheet.timestamps_us))]), CENTIMETRE
        ),
        "contact": contact,
        "protocols": [],
        "shown": [],
        "closest": None if contact is None else contact["t"],
        "apart": [],
        "cameras": [],
        "pictures": [],
        "edges": {},
    }
    removal_times = _find_removal_times(row, ticks)
    if not named_drive.shows_all_agents or removal_times or row.window is not None:
        tracks = [_cut_track(agent, seconds, removal_times) for agent in _list_known_agents(named_drive, sheet)]
        tracks = [*mark_from_departure(tracks, row.window, frame_seconds(sheet))]
        data["agents"] = [build_agent(track) for track in tracks if track.x_m]
    if adversary is not None:
        data["moved"] = build_agent(_cut_track(adversary, seconds, removal_times))
    if row.window is not None:
        begins_s = float(ticks[min(row.primed, len(ticks)) - 1])
        data |= {"opens": round(begins_s, 3), "strip": _build_strip(row, begins_s, float(seconds[-1]))}
    search_trace = read_search_trace(named_drive.record.directory, row)
    data |= {} if search_trace is None else {"considered": build_search_trace(sheet, search_trace)}
    return data | _build_plans(named_drive, seconds, ticks, states)


def _list_known_agents(named_drive: _NamedDrive, sheet: ScenePage) -> Sequence[PageAgent]:
    """Who is where the sheet has it: all where nobody answers, else those that keep their tracks by a window."""
    if named_drive.shows_all_agents:
        return sheet.agents
    window = named_drive.row.window
    return [agent for agent in sheet.agents if window is not None and agent.id in window.adversaries]


def _build_strip(row: EpisodeRow, begins_s: float, end_s: float) -> list[list[str]]:
    """Elements of the strip below the time line: kind, place, title and text of each."""
    bars = [
        [
            "ttc",
            f"left:{100 * step.start_s / end_s:.2f}%;"
            f"width:{100 * (min(step.end_s, end_s) - step.start_s) / end_s:.2f}%;"
            f"height:{100 * step.share:.0f}%",
            f"time to collision {format_number(step.ttc_s, 1)} s at {format_number(step.start_s, 1)} s",
            "",
        ]
        for step in list_strip_steps(row, begins_s)
        if step.start_s < end_s
    ]
    touches = [
        [
            "touch cp-touch-adversary" if adversary else "touch",
            f"left:{min(100 * seconds / end_s, 100):.2f}%",
            f"at {format_number(seconds, 1)} s touches {words}",
            f"{words} ✕",
        ]
        for seconds, words, adversary in list_touches(row, begins_s)
    ]
    return [*bars, *touches]


def _find_removal_times(row: EpisodeRow, ticks: Floats) -> dict[str, float]:
    """When those who touched the ego without its fault are gone, seconds by identifier: the next planning instant."""
    removal_times = {}
    for touch in row.passed:
        at = int(np.searchsorted(ticks, float(ticks[row.primed - 1]) + touch.seconds - _LATE_S))
        removal_times[touch.agent] = float(ticks[min(at, len(ticks) - 1)])
    return removal_times


def _cut_track(agent: PageAgent, seconds: Floats, removal_times: Mapping[str, float]) -> PageAgent:
    if agent.id not in removal_times:
        return agent
    frames = max(int(np.searchsorted(seconds, removal_times[agent.id] - _LATE_S)) - agent.first, 0)
    columns = ("x_m", "y_m", "yaw_rad")
    return agent.model_copy(update={name: getattr(agent, name)[:frames] for name in columns})


def build_driven_adversary(sheet: ScenePage, row: EpisodeRow) -> PageAgent | None:
    """An adversary that answers, as it drove, and as recorded up to its hand-over; ``None`` if the sheet lacks it."""
    went = row.adversary
    agent = next((agent for agent in sheet.agents if went is not None and agent.id == went.uuid), None)
    if went is None or agent is None:
        return None
    begins = min(agent.first, went.start)
    boxes = [agent_box(agent, frame) for frame in range(begins, went.start)]
    before = [(None, None, None) if box is None else (float(box[0]), float(box[1]), float(box[4])) for box in boxes]
    x, y = sheet.origin_m
    poses = before + [(pose[0] - x, pose[1] - y, pose[2]) for pose in went.poses]
    columns = dict(zip(("x_m", "y_m", "yaw_rad"), zip(*poses, strict=True), strict=True))
    return agent.model_copy(update={"adversary": True, "first": begins, **columns})


def _build_plans(named_drive: _NamedDrive, seconds: Floats, ticks: Floats, states: Floats) -> dict[str, Any]:
    row, planner = named_drive.row, named_drive.record.facts.planner
    samples: list[dict[str, Any]] = []
    plan_entries: list[dict[str, Any] | None] = []
    # A drive that failed has an instant without a plan; the instant at which a drive ends has none either.
    plans = [*row.plans, *([None] if row.failure is not None else [])]
    for number, (plan, t) in enumerate(zip(plans, ticks, strict=False)):
        if t > seconds[-1] + 0.5:
            break
        frame = int(np.argmin(np.abs(seconds - t)))
        command = row.ticks.command[number] if number < len(row.ticks.command) else None
        samples.append({"frame": frame, "t": round(float(t), 3), "command": command})
        if plan is None:
            assert row.failure is not None
            lines = row.failure.text.strip().splitlines() or [row.failure.reason]
            plan_entries.append({"failed": lines[-1][:ERROR_CHARACTERS]})
            continue
        plan_entries.append(_build_plan(np.array(plan.waypoints, np.float64), plan.frame, states[number, :3]))
    shown = name_cell(named_drive.name, planner).text
    model = {"name": named_drive.name, "shown": shown, "first": [], "samples": plan_entries}
    return {"samples": samples, "models": [model]}


def _build_plan(waypoints: Floats, frame: str, axle: Floats) -> dict[str, Any] | None:
    placed = place_waypoints(waypoints, frame, LIDAR_FROM_REAR_AXLE_M, axle)
    if placed is None:
        return None
    start = axle[:2] + LIDAR_FROM_REAR_AXLE_M * np.array([np.cos(axle[2]), np.sin(axle[2])])
    return {
        "path": pack_path(np.vstack([start, placed.waypoints]), CENTIMETRE),
        "yaw": pack_series(placed.at_waypoints[:, 4].tolist(), MILLIRADIAN),
        "judged": [],
    }


def _build_contact(
    named_drive: _NamedDrive, sheet: ScenePage, adversary: PageAgent | None, ticks: Floats, states: Floats
) -> dict[str, float] | None:
    """When and where the drive ended, by the stored states; between the bodies where the other's place is known."""
    row = named_drive.row
    if row.contact is None:
        return None
    t = float(ticks[row.primed - 1]) + row.contact.seconds
    x, y, yaw = interpolate_poses(np.array([t]), ticks, states)[0]
    ego, ahead = sheet.ego, sheet.ego.centre_ahead_m
    box = np.array([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), ego.length_m, ego.width_m, yaw])
    known = [*([] if adversary is None else [adversary]), *_list_known_agents(named_drive, sheet)]
    agent = next((known_agent for known_agent in known if known_agent.id == row.contact.agent), None)
    other = None if agent is None else agent_box_at(sheet, agent, t)
    point = box[:2] if other is None else find_shared_point(box, other)
    return {"t": round(t, 3), "x": round(float(point[0]), 2), "y": round(float(point[1]), 2)}


def interpolate_poses(seconds: Floats, ticks: Floats, states: Floats) -> Floats:
    """Poses of the ego, (F, 3) x, y, yaw: a cubic through places and speeds, headings by the shortest turn.

    Times are held to the (K,) ticks of the states, which are (K, 4 or more) x, y, yaw, speed along the heading.
    """
    yaw = np.unwrap(states[:, _YAW])
    if len(ticks) == 1:
        return np.repeat(states[:1, :3], len(seconds), axis=0)
    now = np.clip(seconds, ticks[0], ticks[-1])
    at = np.clip(np.searchsorted(ticks, now, side="right") - 1, 0, len(ticks) - 2)
    step = ticks[at + 1] - ticks[at]
    s = ((now - ticks[at]) / step)[:, None]
    velocity = states[:, _SPEED, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    first, second = states[at, :2], states[at + 1, :2]
    out, into = velocity[at] * step[:, None], velocity[at + 1] * step[:, None]
    # Hermite's basis: at the first state, its speed, at the second, its speed.
    weights = 2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s, 3 * s**2 - 2 * s**3, s**3 - s**2
    place = weights[0] * first + weights[1] * out + weights[2] * second + weights[3] * into
    turned = yaw[at] + s[:, 0] * (yaw[at + 1] - yaw[at])
    return np.column_stack([place, (turned + np.pi) % (2 * np.pi) - np.pi])


def build_search_trace(sheet: ScenePage, frames: Sequence[SearchTraceFrame]) -> list[dict[str, Any]]:
    """Planning frames of an adversary, in force until the next; the drive is of the sheet's scene.

    Each has ``t`` (seconds from the first frame), ``did`` (`benchmark.records.search_trace`), ``paths`` (x, y in turn
    of each candidate, decimetres as steps, worst first), ``shares`` (of each, hundredths: 0 for the best score, 100 for
    the worst or infinite ones) and ``chosen`` (x, y in turn of the one that was driven; null where none was).
    """
    entries = []
    for trace_frame in frames:
        candidates = trace_frame.candidates
        points = np.array(candidates, np.float64) - np.array(sheet.origin_m) if candidates else _NOWHERE
        ranked = rank_candidates(points, trace_frame.scores, trace_frame.chosen)
        entries.append(
            {
                "t": round((trace_frame.time_us - sheet.timestamps_us[0]) * 1e-6, 3),
                "did": trace_frame.did,
                "paths": [pack_path(path, DECIMETRE) for path in ranked.paths],
                "shares": [round(100 * share) for share in ranked.shares.tolist()],
                "chosen": None if ranked.chosen is None else pack_path(ranked.chosen, DECIMETRE),
            }
        )
    return entries
