"""Scenes that never were, made by formulas in milliseconds: a bent road, the ego, traffic, one car that cuts in.

Everything is thought of along the road: ``s`` metres along the ego's lane, ``d`` metres to the left of its middle.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M, EGO_WIDTH_M, FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed, make_token
from benchmark.records.run_schema import DataFacts
from benchmark.records.scene_pages import CAMERA_GRID, SCHEMA, ScenePage, picture_name

LANE_M = 3.5
MANOEUVRES = ("cut-in-left", "cut-in-right", "braking-ahead", "squeezing-left", "tailgating", "oncoming")
PLACES = ("straight", "bend", "junction", "roundabout")
CELL_WIDTH_PX, CELL_HEIGHT_PX = 96, 54
FIRST_TIMESTAMP_US = 1_700_000_000_000_000


@dataclass(frozen=True, slots=True)
class Traffic:
    """Everything else on the road, along it."""

    s_m: Floats
    d_m: Floats
    turned_rad: Floats
    size_m: Floats
    categories: tuple[str, ...]
    first: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class MadeScene:
    """One scene."""

    name: str
    source: str
    description: str
    manoeuvre: str | None
    bend_per_m: float
    origin_m: tuple[float, float]
    heading_rad: float
    ego_s_m: Floats
    others: Traffic
    cut_in_s: float

    @property
    def frames(self) -> int:
        """Number of 12 Hz frames."""
        return len(self.ego_s_m)

    @property
    def keyframes(self) -> range:
        """Frames that are samples."""
        return range(0, self.frames, FRAMES_PER_KEYFRAME)

    def time_us(self, frame: int) -> int:
        """When a frame is."""
        return FIRST_TIMESTAMP_US + round(1e6 * frame / FRAME_HZ)

    def sample_token(self, frame: int) -> str:
        """Token of a keyframe."""
        return make_token("made sample", self.name, frame)

    def agent(self, row: int) -> str:
        """Instance identifier of one of the others."""
        return make_token("made agent", self.name, row)

    def on_plane(self, s_m: Floats, d_m: Floats | float = 0.0) -> Floats:
        """(..., 3) x, y, heading of places on the road, relative to ``origin_m``."""
        turned, d = self.bend_per_m * s_m, np.broadcast_to(d_m, np.shape(s_m))
        radius = 1.0 / self.bend_per_m
        along = (radius - d) * np.sin(turned)
        across = radius - (radius - d) * np.cos(turned)
        cos, sin = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return np.stack([cos * along - sin * across, sin * along + cos * across, turned + self.heading_rad], axis=-1)


def make_scene(
    name: str, source: str, *, adversarial: bool, agents: int, samples: int, description: str, seed: int
) -> MadeScene:
    """Make one scene."""
    rng = np.random.default_rng(content_seed("made scene", source, seed))
    own = np.random.default_rng(content_seed("made adversary", name, seed))
    time = np.arange(samples * FRAMES_PER_KEYFRAME) / FRAME_HZ
    speed, slow = rng.uniform(7.0, 10.0), rng.uniform(2.5, 4.5)
    cut_in_s = float(own.uniform(0.35, 0.6) * time[-1])
    slowed = np.clip((time - cut_in_s + 0.5) / 2.0, 0.0, 1.0) if adversarial else np.zeros_like(time)
    ego = np.concatenate([[0.0], np.cumsum((speed + (slow - speed) * slowed)[:-1] / FRAME_HZ)])
    others = _traffic(rng, time, agents - adversarial)
    if adversarial:
        others = _with_adversary(others, own, time, ego, cut_in_s)
    x, y, heading, bend = (float(rng.uniform(*ends)) for ends in ((300, 1900), (300, 1900), (-3, 3), (0.002, 0.012)))
    return MadeScene(
        name=name,
        source=source,
        description=description,
        manoeuvre=MANOEUVRES[int(own.integers(len(MANOEUVRES)))] if adversarial else None,
        bend_per_m=bend * float(rng.choice([-1, 1])),
        origin_m=(round(x, 2), round(y, 2)),
        heading_rad=heading,
        ego_s_m=ego,
        others=others,
        cut_in_s=cut_in_s,
    )


def _traffic(rng: np.random.Generator, time: Floats, count: int) -> Traffic:
    """Cars beside and against the ego, parked ones, people; nobody in its lane."""
    kind = np.arange(count) % 4
    lane = np.choose(kind, [2 * LANE_M, 3 * LANE_M, -2.1 * LANE_M, -2.9 * LANE_M])
    speed = np.choose(kind, [rng.uniform(6, 10, count), -rng.uniform(7, 12, count), 0.0, rng.uniform(-1.4, 1.4, count)])
    start = rng.uniform(-30, 170, count) + np.where(kind == 1, 60.0, 0.0)
    person = kind == 3
    size = np.where(person[:, None], [0.7, 0.7, 1.75], [4.5, 1.85, 1.6]) * rng.uniform(0.92, 1.08, (count, 1))
    return Traffic(
        s_m=start[:, None] + speed[:, None] * time,
        d_m=np.repeat((lane + rng.uniform(-0.3, 0.3, count))[:, None], len(time), axis=1),
        turned_rad=np.where(speed < 0, np.pi, 0.0),
        size_m=size,
        categories=tuple("human.pedestrian.adult" if walks else "vehicle.car" for walks in person),
        first=tuple(int(frame) for frame in rng.integers(0, 12, count) * (rng.random(count) < 0.3)),
    )


def _with_adversary(others: Traffic, rng: np.random.Generator, time: Floats, ego: Floats, cut_in_s: float) -> Traffic:
    """Overtakes, then moves over right in front of the slowing ego."""
    ahead = np.clip((time - cut_in_s + 3.0) / 3.0, 0.0, 1.0)
    over = np.clip((time - cut_in_s + 0.8) / 1.8, 0.0, 1.0)
    gap = -5.0 + (13.0 + rng.uniform(0.0, 6.0)) * ahead**2 * (3 - 2 * ahead)
    side = float(rng.choice([-1.0, 1.0])) * LANE_M
    return Traffic(
        s_m=np.vstack([others.s_m, ego + gap]),
        d_m=np.vstack([others.d_m, side * (1 - over**2 * (3 - 2 * over))]),
        turned_rad=np.append(others.turned_rad, 0.0),
        size_m=np.vstack([others.size_m, [4.6, 1.9, 1.6]]),
        categories=(*others.categories, "vehicle.car"),
        first=(*others.first, 0),
    )


def sheet_of(scene: MadeScene, data: DataFacts, split: str, pictures: dict[str, str]) -> ScenePage:
    """What is shown of a scene."""
    ego, label = scene.on_plane(scene.ego_s_m), labels_of(scene)
    frames = tuple(frame for frame in range(scene.frames) if picture_name(frame) in pictures)
    return ScenePage.model_validate(
        {
            "schema": SCHEMA,
            "data": data,
            "split": split,
            "scene": scene.name,
            "source": scene.source,
            "description": scene.description,
            "labels": [] if label is None else [label],
            "origin_m": scene.origin_m,
            "timestamps_us": tuple(map(scene.time_us, range(scene.frames))),
            "keyframes": tuple(scene.keyframes),
            "sample_tokens": tuple(scene.sample_token(frame) for frame in scene.keyframes),
            "ego": {
                **_columns(ego),
                "length_m": EGO_LENGTH_M,
                "width_m": EGO_WIDTH_M,
                "centre_ahead_m": EGO_CENTER_FROM_REAR_AXLE_M,
            },
            "agents": [_agent(scene, row) for row in range(len(scene.others.categories))],
            "road": _road(scene),
            "cameras": _cameras() if pictures else (),
            "pictures": frames,
            "adversary_edges": {str(frame): _edges(scene, frame) for frame in frames if scene.manoeuvre is not None},
            "files": pictures,
        }
    )


def labels_of(scene: MadeScene) -> dict[str, Any] | None:
    """What the adversary does, as the generator would label it; ``None`` in recordings."""
    if scene.manoeuvre is None:
        return None
    at = {"time_s": round(scene.cut_in_s, 3), "gap_m": 0.4}
    return {
        "manoeuvre": scene.manoeuvre,
        "place": PLACES[content_seed(scene.name) % len(PLACES)],
        "closest_approach": {**at, "frame": round(scene.cut_in_s * FRAME_HZ), "side": "front"},
        "encroachment": None,
        "occurred": [{"kind": scene.manoeuvre, "first_s": at["time_s"], "duration_s": 2.0, "least_gap_m": 0.4}],
        "time_to_collision": {"seconds": 0.9, "time_s": at["time_s"]},
    }


def _agent(scene: MadeScene, row: int) -> dict[str, Any]:
    others, first = scene.others, scene.others.first[row]
    places = scene.on_plane(others.s_m[row, first:], others.d_m[row, first:])
    places[:, 2] += others.turned_rad[row]
    # Somebody who was out of sight for a while: null in the middle.
    hidden = range(40, 46) if row % 7 == 3 else ()
    columns = {
        name: tuple(None if frame in hidden else value for frame, value in enumerate(values))
        for name, values in _columns(places).items()
    }
    return {
        "id": scene.agent(row),
        "category": others.categories[row],
        "size_m": tuple(np.round(others.size_m[row], 2).tolist()),
        "adversary": scene.manoeuvre is not None and row == len(others.categories) - 1,
        "first": first,
        **columns,
    }


def _columns(places: Floats) -> dict[str, tuple[float, ...]]:
    x, y, yaw = np.round(places, 3).T.tolist()
    return {"x_m": tuple(np.round(x, 2).tolist()), "y_m": tuple(np.round(y, 2).tolist()), "yaw_rad": tuple(yaw)}


def _road(scene: MadeScene) -> dict[str, Any]:
    length = float(scene.ego_s_m[-1]) + 60.0
    s = np.linspace(-50.0, length, 60)

    def line(d_m: float) -> list[list[float]]:
        return [list(point) for point in np.round(scene.on_plane(s, d_m)[:, :2], 2).tolist()]

    def band(low_m: float, high_m: float) -> list[list[list[float]]]:
        return [[*line(low_m), *line(high_m)[::-1]]]

    crossing = scene.on_plane(np.array([60.0, 64.0, 64.0, 60.0]), np.array([-7.0, -7.0, 12.25, 12.25]))
    return {
        "drivable": [band(-2.5 * LANE_M, 3.5 * LANE_M)],
        "crossings": [[np.round(crossing[:, :2], 2).tolist()]],
        "walkways": [band(-3.4 * LANE_M, -2.5 * LANE_M), band(3.5 * LANE_M, 4.2 * LANE_M)],
        "dividers": [
            {"points": line((lane + 0.5) * LANE_M), "paint": paint}
            for lane, paint in ((-1, "dashed-white"), (0, "dashed-white"), (1, "solid-yellow"), (2, "dashed-white"))
        ],
    }


def _cameras() -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "left": column * CELL_WIDTH_PX,
            "top": row * CELL_HEIGHT_PX,
            "width": CELL_WIDTH_PX,
            "height": CELL_HEIGHT_PX,
        }
        for row, names in enumerate(CAMERA_GRID)
        for column, name in enumerate(names)
    ]


def _edges(scene: MadeScene, frame: int) -> dict[str, list[tuple[float, float, float, float]]]:
    """A box in the front camera's cell that comes nearer as the adversary does."""
    gap = float(scene.others.s_m[-1, frame] - scene.ego_s_m[frame])
    if gap < 3.0:
        return {}
    half = min(20.0, 120.0 / gap)
    x, y = CELL_WIDTH_PX * 1.5 - 4.0 * float(scene.others.d_m[-1, frame]), CELL_HEIGHT_PX / 2
    corners = [(x - half, y - half / 2), (x + half, y - half / 2), (x + half, y + half / 2), (x - half, y + half / 2)]
    behind = [(left + half / 3, top - half / 6) for left, top in corners]
    pairs = [(ring[i], ring[(i + 1) % 4]) for ring in (corners, behind) for i in range(4)]
    pairs += list(zip(corners, behind))
    low, high = (CELL_WIDTH_PX, 0), (2 * CELL_WIDTH_PX, CELL_HEIGHT_PX)
    ends = [np.clip((*first, *second), (*low, *low), (*high, *high)) for first, second in pairs]
    return {"CAM_FRONT": [tuple(np.round(end, 1).tolist()) for end in ends]}
