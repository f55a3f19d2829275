"""Picture of a recording replayed beside the same recording with the served adversary.

``python docs/making/traffic.py`` makes ``docs/images/traffic.png`` anew, in half a minute.
"""

import argparse
from pathlib import Path
from typing import Any, Final

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Polygon
from shapely.geometry.polygon import orient

import benchmark
from adapters.registry import build_planner
from benchmark.api.serving import serve_traffic
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import Episode, EpisodeSpec, run_episode
from benchmark.closed_loop.observation_builder import NoSensor
from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M
from benchmark.geometry import Floats, box_corners
from benchmark.machine.extension import import_from_extension
from benchmark.report.palette import ADVERSARY, EGO, format_hexadecimal
from benchmark.runs.redriving import read_recorded_can
from benchmark.scene import Scene

PICTURE: Final = Path(__file__).resolve().parents[1] / "images" / "traffic.png"
SCENE: Final = "scene-8003"
EGO_PLANNER: Final = "constant-velocity-on-path"
HALF_M: Final = 32.0
TRAIL: Final = 30
"""Tenths of a second that are drawn behind each."""
OTHERS: Final = "#8a8f98"
ROAD: Final = "#e9eaee"


def main() -> None:
    """Drive twice, and draw both at the moment of the contact."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--to", type=Path, default=PICTURE)
    to = parser.parse_args().to
    data = benchmark.open_data("mini")
    scene = data.scene(SCENE)
    replayed = drive(data, scene, DefaultBackend("replay"))
    with serve_traffic() as server:
        maker = import_from_extension("agents scheme", "grpc")(server.url)
        challenged = drive(data, scene, DefaultBackend("adversary", adversary=maker))
    assert challenged.touch is not None and challenged.adversary is not None
    frame = len(challenged.motion.times_us) - 1
    figure, axes = plt.subplots(1, 2, figsize=(10.0, 5.2), dpi=110)
    for panel, title, episode in zip(axes, ("replay", "challenged"), (replayed, challenged)):
        draw(panel, scene, episode, frame, challenged)
        panel.set_title(title, fontsize=11, loc="left")
    figure.tight_layout()
    figure.savefig(to)


def drive(data: Any, scene: Scene, backend: DefaultBackend) -> Episode:
    """One drive of the ego."""
    spec = EpisodeSpec(scene, read_recorded_can(data, scene.name), 0, backend, NoSensor(), 60.0)
    return run_episode(spec, build_planner(EGO_PLANNER))


def draw(panel: Any, scene: Scene, episode: Episode, frame: int, challenged: Episode) -> None:
    """Everybody at one instant, around where the ego is in the challenged drive, with the way that they came."""
    assert challenged.adversary is not None
    motion, centre = episode.motion, challenged.motion.ego[frame, :2]
    for part in scene.road_map.drivable_area.geoms:
        panel.add_patch(Polygon(np.array(orient(part).exterior.coords), facecolor=ROAD, edgecolor="none"))
        for hole in part.interiors:
            panel.add_patch(Polygon(np.array(hole.coords), facecolor="white", edgecolor="none"))
    rows = slice(max(frame - TRAIL, 0), frame + 1)
    for agent in np.flatnonzero(motion.present[:, frame]):
        colour = format_hexadecimal(ADVERSARY) if agent == challenged.adversary.agent else OTHERS
        pose = np.array([*motion.position[agent, frame, :2], motion.yaw[agent, frame]])
        add_box(panel, pose, scene.agents.size[agent, :2], colour)
        panel.plot(*motion.position[agent, rows, :2].T, color=colour, linewidth=1.2)
    yaw = motion.ego[:, 2]
    ahead = EGO_CENTER_FROM_REAR_AXLE_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
    places = np.column_stack([motion.ego[:, :2] + ahead, yaw])
    add_box(panel, places[frame], scene.ego.boxes[0, 2:4], format_hexadecimal(EGO))
    panel.plot(*places[rows, :2].T, color=format_hexadecimal(EGO), linewidth=1.2)
    panel.set_xlim(centre[0] - HALF_M, centre[0] + HALF_M)
    panel.set_ylim(centre[1] - HALF_M, centre[1] + HALF_M)
    panel.set_aspect("equal")
    panel.set_axis_off()


def add_box(panel: Any, pose: Floats, size: Floats, colour: str) -> None:
    """A body."""
    box = np.array([*pose[:2], *size, pose[2]])
    panel.add_patch(Polygon(box_corners(box), facecolor=colour, edgecolor="white", linewidth=0.6, zorder=3))


if __name__ == "__main__":
    main()
