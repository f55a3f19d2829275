"""Closed loop and pictures: stepping, drives with and without images, the wire, the schematic renderer."""

import hashlib
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.speed.case import Case
from benchmark import api
from benchmark.cli.drive import BASELINES, TOGETHER
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import EpisodeSpec, run_episode
from benchmark.closed_loop.idm_policy import IdmPolicy
from benchmark.closed_loop.scoring import score_episode
from benchmark.closed_loop.simulation_config import (
    build_log_replay,
    build_simulation_config,
    interpolate_recorded_poses,
)
from benchmark.closed_loop.stepping import begin_simulation, step, step_together
from benchmark.closed_loop.world_state import STEP_US, SimulationConfig, WorldState
from benchmark.extensions.http.model import http_planner
from benchmark.geometry import Floats, to_local
from benchmark.machine.workers import map_ordered
from benchmark.planning import SceneInfo
from benchmark.records.drives import ROWS_FILE
from benchmark.runs.drive_estimate import estimate_driving
from benchmark.runs.driving import drive_planners, drive_split
from benchmark.runs.redriving import read_recorded_can
from benchmark.scene import Scene
from generation.render.schematic import FIRST, SECOND, SchematicRenderer
from generation.render.sensor import SchematicSensor
from generation.sources.town import build_town_scene
from tests.benchmark.closed_loop.seeing import Looking
from tests.benchmark.closed_loop.staged import staged
from tests.benchmark.extensions.http.made import serving
from tests.hand_made import scene_on_straight_road

STEPS = 38
"""Of a drive: 19 s."""
SIZE = (448, 256)
STYLES = {"first": FIRST, "second": SECOND}


def courses(agents: str, quick: bool, _folder: Path) -> tuple[list[SimulationConfig], list[Floats]]:
    """Courses of the town, and the recorded places that plans are made from."""
    pairs = []
    for scene in (build_town_scene("val", number) for number in range(2 if quick else 10)):
        course = build_simulation_config(scene)
        if agents == "idm":
            replay = build_log_replay(scene, course.start_us, course.end_us)
            course = replace(course, policy=IdmPolicy.of(replay, scene.agents.categories, scene.road_map))
        pairs.append(
            (course, interpolate_recorded_poses(scene, course.start_us + STEP_US * np.arange(STEPS + 7))[:, :2])
        )
    step_through(pairs, together=False)
    pairs *= 10 if agents == "replay" and not quick else 1
    return [course for course, _ in pairs], [places for _, places in pairs]


def step_through(found: Any, *, together: bool) -> tuple[float, list[WorldState]]:
    """Scene-seconds, and the worlds at the end."""
    runs, ahead = found if isinstance(found, tuple) else zip(*found)
    worlds = [begin_simulation(course) for course in runs]
    for number in range(STEPS):
        plans = [to_local(places[number + 1 : number + 7], world.ego.pose) for places, world in zip(ahead, worlds)]
        worlds = step_together(runs, worlds, plans) if together else list(map(step, runs, worlds, plans))
    return len(worlds) * STEPS * 0.5, worlds


def driven_scene(name: str, quick: bool, folder: Path) -> Any:
    """A miniature, warmed up, and the first scene of `adv` of the embedded data."""
    data = api.open_split(api.open_data("mini"), "adv", folder)
    scene = data.scene(data.scene_names("adv")[0])
    planner, seen = api.load_planner(name)(), list(data.observations(scene.name))
    about = SceneInfo(scene.name, scene.road_map.location, scene.cameras)
    planner.reset(about)
    # The first plan of a network makes what later ones have.
    planner.plan(seen[0])
    stage = EpisodeSpec(scene, read_recorded_can(data, scene.name), 0, DefaultBackend(), SchematicSensor(), 600.0)
    return (replace(stage, most_plans=2) if quick else stage), planner, seen, about


def drive_and_score(state: Any) -> tuple[float, Any]:
    record = run_episode(state[0], state[1])
    score_episode(state[0].scene, record)
    return len(record.plans), record


def draw_and_plan(state: Any) -> tuple[float, Any]:
    """Rendering and planning in open loop of all frames that have an observation."""
    stage, planner, seen, about = state
    frames = stage.scene.keyframes[: stage.most_plans or len(seen)].tolist()
    camera = stage.scene.cameras[0]
    for _ in SchematicRenderer(camera.width, camera.height, style=SECOND).render(stage.scene, frames):
        pass
    planner.reset(about)
    for observation in seen[: len(frames)]:
        planner.plan(observation)
    return len(frames), None


def planners_to_drive(agents: str, quick: bool, folder: Path) -> Any:
    data, planners = api.open_data("mini"), [api.load_planner(name) for name in BASELINES]
    # What is imported or read for the first time is nobody's.
    drive_planners(data, "val", planners, folder / "warm", api.drive_settings("val", limit=1))
    return data, planners, api.drive_settings("val", agents=agents, limit=1 if quick else 10), folder


def drive_all(state: Any, *, together: bool) -> tuple[float, Any]:
    """Records written and read back; the bytes of their rows."""
    data, planners, settings, folder = state
    if together:
        records = drive_planners(data, "val", planners, folder / "beside", replace(settings, together=TOGETHER))
    else:
        records = [drive_split(data, "val", item, folder / "alone", settings) for item in planners]
    return sum(len(item.rows) for item in records), [(item.directory / ROWS_FILE).read_bytes() for item in records]


def estimates(state: Any, _found: Any) -> str:
    """What `drive --dry-run` says of each planner."""
    data, planners, settings, folder = state
    durations = [
        estimate_driving(data, "val", planner, settings, folder / "dry").rpartition("about ")[2] for planner in planners
    ]
    return "a dry run says " + ", ".join(durations)


def looking(size: tuple[int, int], quick: bool, _folder: Path) -> Any:
    scene = scene_on_straight_road(seconds=4.0)
    scene = replace(scene, cameras=tuple(camera.resized(*size) for camera in scene.cameras))
    stage = replace(staged(scene, timeout_s=600.0), sensor=SchematicSensor(), most_plans=1 if quick else 4)
    # The server ends with the process.
    return stage, (stack := ExitStack()).enter_context(serving(Looking())), stack


def plan(over_http: str | None, state: Any) -> tuple[float, Any]:
    """Planned by the server, with pictures in a format; or in this process."""
    run_episode(state[0], http_planner(state[1], image_format=over_http) if over_http else Looking())
    return state[0].most_plans, None


def looking_twice(size: tuple[int, int], quick: bool, folder: Path) -> Any:
    """The same with a server of each protocol."""
    from tests.benchmark.extensions.alpasim.made import serving as serving_grpc

    stage, http, stack = looking(size, quick, folder)
    return stage, http, stack.enter_context(serving_grpc(Looking, wants_images=True)).url, stack


def plan_over_grpc(state: Any) -> tuple[float, Any]:
    """Planned by an egodriver service, with pictures as PNG."""
    from benchmark.extensions.alpasim.model import egodriver_planner

    planner = egodriver_planner(state[2], image_format="png")
    run_episode(state[0], planner)
    planner.end_session()
    return state[0].most_plans, None


def frames_of(step_frames: int, quick: bool, _folder: Path) -> tuple[Scene, range]:
    scene = build_town_scene("val", 0)
    return scene, range(0, len(scene.timestamps_us), step_frames)[: 3 if quick else 120]


def draw(style: str, state: Any) -> tuple[float, Any]:
    """A hash of all pictures."""
    seen = hashlib.sha256()
    for images in SchematicRenderer(*SIZE, STYLES[style]).render(*state):
        for picture in images.values():
            seen.update(picture.tobytes())
    return len(state[1]), seen.hexdigest()


def draw_part(frames: range) -> int:
    return sum(1 for _ in SchematicRenderer(*SIZE).render(build_town_scene("val", 0), frames))


def draw_in(processes: int, state: Any) -> tuple[float, Any]:
    frames = state[1]
    parts = [frames[first::processes] for first in range(processes)]
    return sum(map_ordered(draw_part, parts, workers=processes, label="rendering")), None


CASES = (
    *(
        Case(
            f"closed-loop/{agents}",
            f"Scenes of the town stepped together, {agents} agents, no images.",
            partial(courses, agents),
            partial(step_through, together=True),
            "scene-second",
            other=("one by one", partial(step_through, together=False)),
            same=lambda _, one, other: all(a.ego == b.ego for a, b in zip(one, other, strict=True)),
            more=lambda state, _: f"{len(state[0])} scenes",
            most_s=0.001 if agents == "replay" else None,
        )
        for agents in ("replay", "idm")
    ),
    *(
        Case(
            f"driving/{name}",
            f"A drive of {name} with schematic images and scores, beside rendering and planning in open loop.",
            partial(driven_scene, name),
            drive_and_score,
            "plan",
            other=("rendering and planning", draw_and_plan),
            least_ratio=1 / 1.5,
        )
        for name in ("vad-mini", "sparsedrive-mini", "uniad-mini")
    ),
    *(
        Case(
            f"driving-together/{agents}",
            f"The planners that every table has, side by side through scenes of the embedded data, {agents} agents.",
            partial(planners_to_drive, agents),
            partial(drive_all, together=True),
            "drive",
            other=("one after another", partial(drive_all, together=False)),
            same=lambda _, one, other: one == other,
            more=estimates,
            fresh=True,
        )
        for agents in ("replay", "idm")
    ),
    *(
        Case(
            f"wire/{image_format}-{size[0]}x{size[1]}",
            f"A planning instant over sockets, pictures of {size[0]} x {size[1]} drawn and looked at, {what}.",
            partial(looking, size),
            partial(plan, image_format),
            "plan",
            other=("in `eval`", partial(plan, None)),
            wall=True,
            needs=("httpx2",),
        )
        for size in (SIZE, (1600, 900))
        for image_format, what in (("torch", "saved tensors"), ("png", "PNG"))
    ),
    *(
        Case(
            f"wire/alpasim-png-{size[0]}x{size[1]}",
            f"A planning instant over gRPC, six PNGs of {size[0]} x {size[1]} drawn and looked at, beside HTTP.",
            partial(looking_twice, size),
            plan_over_grpc,
            "plan",
            other=("over HTTP", partial(plan, "png")),
            wall=True,
            needs=("httpx2", "grpc"),
            least_ratio=1.0,
        )
        for size in (SIZE, (1600, 900))
    ),
    *(
        Case(
            f"rendering/{what}-{style}-style",
            f"Six views of 448 x 256 of {what.replace('-', ' ')} of a town scene, {style} style.",
            partial(frames_of, step_frames),
            partial(draw, style),
            "frame",
            digest=str,
        )
        for what, step_frames in (("samples", 6), ("all-frames", 1))
        for style in STYLES
    ),
    Case(
        "rendering/two-processes",
        "Six views of 448 x 256 in two processes, beside one.",
        partial(frames_of, 1),
        partial(draw_in, 2),
        "frame",
        other=("one process", partial(draw_in, 1)),
        wall=True,
    ),
)
