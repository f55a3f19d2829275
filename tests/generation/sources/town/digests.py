"""What a scene of the town is, in one number: imported by another process without what tests need."""

import hashlib

from benchmark.scene import Scene


def digest(scene: Scene) -> str:
    """SHA-256 over what moves, what is annotated, and the map."""
    agents, notes, road = scene.agents, scene.annotations, scene.road_map
    arrays = (
        scene.timestamps_us, scene.ego.position, scene.ego.rotation, agents.position, agents.yaw, agents.size,
        agents.valid, notes.rotation, notes.visibility, notes.num_lidar_pts,
    )  # fmt: skip
    shapes = (road.drivable_area, *road.walkways.values(), *road.stop_lines.values())
    words = repr((scene.description, agents.ids, agents.categories, notes.attribute.tolist(), sorted(road.lanes)))
    parts = [words.encode(), *(array.tobytes() for array in arrays), *(shape.wkb for shape in shapes)]
    return hashlib.sha256(b"".join(parts)).hexdigest()
