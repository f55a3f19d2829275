"""Random samples and plans for tests of the protocols."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from hypothesis import strategies as st

from benchmark.constants import CATEGORIES
from benchmark.datasets.sample_truth import SampleRoads, SceneRoadSurfaces
from benchmark.geometry import Floats
from benchmark.planning import Command
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.truth import SampleTruth

PARTS = ("boxes", "annotated", "has_points", "has_lidar_points", "seen_before")
"""Arrays of a sample that have a row for each object."""
PLANS = ("drive", "still", "jitter", "reverse", "go back", "leave", "recorded")


@dataclass(frozen=True)
class Traits:
    """What kind of sample: everything else follows from the seed.

    Objects are in a square of half the side ``spread_m``, above 50 some are over the grid's border; ``valid`` steps are
    recorded. If ``coarse``, places, sizes and headings are multiples of 0.25 m and 45 degrees: what is rounded to
    cells then lies on the border between two.
    """

    seed: int
    objects: int
    spread_m: float
    valid: int
    plan: str
    coarse: bool


def traits(*, coarse: bool) -> st.SearchStrategy[Traits]:
    """Kinds of samples."""
    return st.builds(
        Traits, seed=st.integers(0, 2**32), objects=st.integers(0, 12),
        spread_m=st.sampled_from([4.0, 9.0, 20.0, 55.0, 90.0]), valid=st.sampled_from([6, 6, 6, 5, 3, 1, 0]),
        plan=st.sampled_from(PLANS), coarse=st.booleans() if coarse else st.just(False),
    )  # fmt: skip


def made_truth(boxes: Floats, future: Floats, *, name: str = "s", **changes: Any) -> SampleTruth:
    """A sample whose ego looks along +y; cars (M, 7, 5), all annotated and seen unless ``changes`` say otherwise.

    ``future`` is (6, 2), heading straight ahead, or (6, 3).
    """
    boxes = np.asarray(boxes, np.float64).reshape(-1, 7, 5)
    there = changes.get("annotated", np.ones(boxes.shape[:2], np.bool_))
    heading = np.full((6, 3 - np.shape(future)[1]), np.pi / 2)
    content: dict[str, Any] = {
        **{"scene": "scene-0001", "sample_token": name, "index": 0, "timestamp_us": 0, "command": Command.STRAIGHT},
        **{"lidar_pose": np.zeros(3), "lidar_ahead_m": 0.94, "ego_future": np.column_stack([future, heading])},
        "ego_future_valid": np.ones(6, np.bool_),
        "instances": tuple(f"{name}-{row}" for row in range(len(boxes))),
        "categories": ("vehicle.car",) * len(boxes),
        **{"boxes": boxes, "annotated": there, "has_points": there, "has_lidar_points": there},
    }
    return SampleTruth(**{**content, **changes})


def sample_of(kind: Traits, name: str = "s") -> SampleTruth:
    """Objects of all categories with gaps and without points, around a recorded ego that may drive through them."""
    rng = np.random.default_rng([kind.seed, 1])
    count = kind.objects
    boxes = np.empty((count, 7, 5))
    start, step = rng.uniform(-kind.spread_m, kind.spread_m, (count, 1, 2)), rng.normal(0.0, 2.0, (count, 1, 2))
    boxes[..., :2] = start + step * np.arange(7)[None, :, None]
    boxes[..., 2:4] = rng.uniform(0.2, 9.0, (count, 1, 2))
    boxes[..., 4] = rng.uniform(-np.pi, np.pi, (count, 1)) + rng.normal(0.0, 0.2, (count, 1)) * np.arange(7)
    future = np.cumsum(rng.normal([0.0, 2.5], [0.4, 1.0], (6, 2)), axis=0)
    if kind.coarse:
        boxes[..., :4] = np.maximum(np.round(boxes[..., :4] * 4) / 4, [-100, -100, 0.25, 0.25])
        boxes[..., 4] = np.round(boxes[..., 4] / (np.pi / 4)) * (np.pi / 4)
        future = np.round(future * 4) / 4
    valid = np.arange(6) < kind.valid
    annotated = rng.random((count, 7)) < 0.85
    annotated[:, 1:] &= valid
    points = annotated & (rng.random((count, 7)) < 0.85)
    rng_past = np.random.default_rng([kind.seed, 3])
    return made_truth(
        boxes,
        future,
        name=name,
        index=int(kind.seed % 5),
        adversaries=frozenset(f"{name}-{row}" for row in range(min(count, 2))),
        ego_future_valid=valid,
        categories=tuple(CATEGORIES[kind] for kind in rng.integers(0, len(CATEGORIES), count)),
        annotated=annotated,
        has_points=points,
        has_lidar_points=points & (rng.random((count, 7)) < 0.9),
        seen_before=rng_past.random(count) < 0.8,
        roads=roads_of(rng_past) if kind.seed % 4 else None,
    )


def roads_of(rng: np.random.Generator) -> SampleRoads:
    """A road ahead with a crossing road and an island in it, seen from somewhere on it."""
    width = rng.uniform(5.0, 9.0)
    ahead = shapely.box(-80.0, -width, 120.0, width)
    across = shapely.affinity.rotate(shapely.box(20.0, -90.0, 20.0 + 2 * width, 90.0), rng.uniform(-40, 40))
    island = shapely.Point(rng.uniform(5.0, 40.0), rng.uniform(-3.0, 3.0)).buffer(rng.uniform(0.5, 2.0), quad_segs=4)
    surface = as_multipolygon(shapely.union_all([ahead, across]).difference(island))
    segments = {str(number): polygon for number, polygon in enumerate(surface.geoms)}
    road_map = RoadMap("made-up", surface, road_segments=segments)
    return SampleRoads(SceneRoadSurfaces(road_map), np.array([rng.uniform(-9.0, 9.0), *rng.normal(0.0, [1.0, 0.05])]))


def plan_of(kind: Traits) -> Floats:
    """(6, 2) waypoints."""
    rng = np.random.default_rng([kind.seed, 2])
    steps = np.arange(1, 7)[:, None]
    speed = rng.normal([0.0, 2.5], [0.8, 1.5])
    plan = {
        "drive": np.cumsum(rng.normal(speed, 0.4, (6, 2)), axis=0),
        "still": np.zeros((6, 2)),
        "jitter": rng.normal(0.0, 0.2, (6, 2)),
        "reverse": -np.abs(speed) * steps * [0.1, 1.0],
        "go back": speed * np.array([1.0, 2.0, 3.0, 3.0, 2.0, 1.0])[:, None],
        "leave": speed * steps * rng.uniform(3.0, 12.0),
        "recorded": sample_of(kind).ego_future[:, :2].copy(),
    }[kind.plan]
    return np.asarray(np.round(plan * 4) / 4 if kind.coarse else plan)
