"""What opening a data set of nuScenes trainval's size costs (processor time, memory), here and in another worktree.

Each opening is a process. The first has an empty cache, the second what the first left there (docs/data.md); beside
them what the fingerprint takes. The rows are made up: as many as trainval has, with tokens of its length, in no order.
`--part 1` is the whole of it, 3 GB on disk; the smaller default keeps `make bench` short. The ratio is between the
medians of alternating runs.
"""

import argparse
import json
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.machine.storage import token
from benchmark.machine.user_cache import SETTLED_S

SCENES, SAMPLES, ROWS_A_SAMPLE, OBJECTS = 850, 40, 79, 34
"""850 scenes of 40 samples; 79 sensor rows and 34 annotations to each sample."""
MOST = 1.1
"""What a first opening may cost against the worktree that it is compared with."""
KINDS = ("first", "second")
CHANNELS = (
    *(f"CAM_{place}" for place in ("FRONT", "FRONT_RIGHT", "FRONT_LEFT", "BACK", "BACK_LEFT", "BACK_RIGHT")),
    "LIDAR_TOP",
    *(f"RADAR_{place}" for place in ("FRONT", "FRONT_LEFT", "FRONT_RIGHT", "BACK_LEFT", "BACK_RIGHT")),
)
OPEN = """
import json, resource, sys, time
from pathlib import Path
from benchmark.datasets.nuscenes import NuScenesData
from nuscenes.nuscenes import NuScenes
imported_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
started_s = time.process_time()
data = NuScenesData.open(Path(sys.argv[1]))
opened_s = time.process_time() - started_s
assert type(data._tables).__name__ == "SceneByScene"
started_s = time.process_time()
names = data.scene_names()[:3]
for name in names:
    data.scene(name)
scene_s = (time.process_time() - started_s) / len(names)
most_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - imported_mb
started_s = time.process_time()
data.fingerprint()
print(json.dumps([opened_s, scene_s, most_mb, time.process_time() - started_s]))
"""
Row = dict[str, Any]


def pose(random_: random.Random) -> Row:
    return {
        "translation": [random_.uniform(0, 2000), random_.uniform(0, 2000), 0.0],
        "rotation": [0.5720320396729045, -0.0016977771610471074, 0.011798001930183783, -0.8201446642457809],
    }


def shared_tables(scenes: int) -> dict[str, list[Row]]:
    """The tables that are read whole."""
    sensors = [
        {
            "token": token("sensor", name),
            "channel": name,
            "modality": {"C": "camera", "L": "lidar"}.get(name[0], "radar"),
        }
        for name in CHANNELS
    ]
    logs = [{"token": token("log", 0), "logfile": "n000", "vehicle": "n000", "date_captured": "2018", "location": "x"}]
    random_ = random.Random(0)
    matrix = [[1266.4, 0.0, 816.2], [0.0, 1266.4, 491.5], [0.0, 0.0, 1.0]]
    mounts = [
        {
            "token": token("mount", scene, name),
            "sensor_token": token("sensor", name),
            "camera_intrinsic": matrix if name.startswith("CAM") else [],
            **pose(random_),
            "translation": [1.7, 0.0, 1.5],
        }
        for scene in range(scenes)
        for name in CHANNELS
    ]
    named = [
        {
            "token": token("scene", scene),
            "name": f"made-{scene:04d}",
            "description": "",
            "log_token": logs[0]["token"],
            "nbr_samples": SAMPLES,
            "first_sample_token": token("sample", scene, 0),
            "last_sample_token": token("sample", scene, SAMPLES - 1),
        }
        for scene in range(scenes)
    ]
    return {
        "attribute": [{"token": token("attribute"), "name": "vehicle.moving", "description": ""}],
        "calibrated_sensor": mounts,
        "category": [{"token": token("category"), "name": "vehicle.car", "description": ""}],
        "log": logs,
        "map": [{"token": token("map"), "category": "x", "filename": "maps/x.png", "log_tokens": [logs[0]["token"]]}],
        "scene": named,
        "sensor": sensors,
        "visibility": [{"token": "4", "level": "v80-100", "description": ""}],
    }


def scene_rows(scene: int) -> Iterator[tuple[str, Row]]:
    """Rows of the tables that grow with the scenes."""
    random_ = random.Random(scene)
    start_us = 1_532_402_927_612_460 + scene * 1_000_000_000

    def linked(kind: str, index: int, count: int, *names: object) -> Row:
        link = {"prev": index - 1, "next": index + 1}
        return {
            "token": token(kind, scene, *names, index),
            **{name: token(kind, scene, *names, to) if 0 <= to < count else "" for name, to in link.items()},
        }

    for index in range(SAMPLES):
        yield (
            "sample",
            linked("sample", index, SAMPLES)
            | {
                "timestamp": start_us + index * 500_000,
                "scene_token": token("scene", scene),
            },
        )
    for number, channel in enumerate(CHANNELS):
        every = ROWS_A_SAMPLE // len(CHANNELS) + (number < ROWS_A_SAMPLE % len(CHANNELS))
        count = (SAMPLES - 1) * every + 1
        size = (1600, 900) if channel.startswith("CAM") else (0, 0)
        for index in range(count):
            sample, sweep = divmod(index, every)
            time_us = start_us + sample * 500_000 + sweep * 500_000 // every
            row = linked("data", index, count, channel)
            folder = "sweeps" if sweep else "samples"
            yield "ego_pose", {"token": row["token"], "timestamp": time_us, **pose(random_)}
            yield (
                "sample_data",
                row
                | {
                    "sample_token": token("sample", scene, sample),
                    "ego_pose_token": row["token"],
                    "calibrated_sensor_token": token("mount", scene, channel),
                    "timestamp": time_us,
                    "fileformat": "jpg",
                    "is_key_frame": not sweep,
                    "height": size[1],
                    "width": size[0],
                    "filename": f"{folder}/{channel}/n015-2018-07-24-11-22-45+0800__{channel}__{scene}-{time_us}.jpg",
                },
            )
    for thing in range(OBJECTS):
        yield (
            "instance",
            {
                "token": token("thing", scene, thing),
                "category_token": token("category"),
                "nbr_annotations": SAMPLES,
                "first_annotation_token": token("box", scene, thing, 0),
                "last_annotation_token": token("box", scene, thing, SAMPLES - 1),
            },
        )
        for index in range(SAMPLES):
            yield (
                "sample_annotation",
                linked("box", index, SAMPLES, thing)
                | {
                    "sample_token": token("sample", scene, index),
                    "instance_token": token("thing", scene, thing),
                    "visibility_token": "4",
                    "attribute_tokens": [token("attribute")],
                    "size": [0.621, 0.669, 1.642],
                    "num_lidar_pts": 1,
                    "num_radar_pts": 0,
                    **pose(random_),
                },
            )


def write_made_up(root: Path, scenes: int) -> None:
    """A root with made-up rows; the rows of a table lie in no order (shuffled within blocks of 50 scenes)."""
    folder = root / "v1.0-trainval"
    folder.mkdir(parents=True)
    (root / "maps").mkdir()
    (root / "maps" / "x.png").write_bytes(b"")
    for table, rows in shared_tables(scenes).items():
        (folder / f"{table}.json").write_text(json.dumps(rows, indent=0))
    growing = ("sample", "ego_pose", "sample_data", "instance", "sample_annotation")
    order = random.Random(0).sample(range(scenes), scenes)
    for block in range(0, scenes, 50):
        rows = [made for scene in order[block : block + 50] for made in scene_rows(scene)]
        random.Random(block).shuffle(rows)
        rows.sort(key=lambda made: made[0])
        for table, group in groupby(rows, key=lambda made: made[0]):
            with (folder / f"{table}.json").open("a") as stream:
                stream.write("[\n" if not block else ",\n")
                stream.write(",\n".join(json.dumps(row, indent=0) for _, row in group))
    for table in growing:
        with (folder / f"{table}.json").open("a") as stream:
            stream.write("\n]")


Costs = tuple[float, float, float, float]


def opened(tree: Path, root: Path, cache: Path) -> Costs:
    """Seconds for opening and for a scene, MB above the imports, seconds for the fingerprint, in an own process."""
    command = [sys.executable, "-c", OPEN, str(root)]
    environment = {**os.environ, "CHALLENGER_BENCH_CACHE": str(cache)}
    done = subprocess.run(command, cwd=tree, env=environment, check=True, capture_output=True, text=True)
    opened_s, scene_s, most_mb, fingerprint_s = json.loads(done.stdout.splitlines()[-1])
    return opened_s, scene_s, most_mb, fingerprint_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", type=float, default=0.02, help="of trainval's 850 scenes")
    parser.add_argument("--against", type=Path, help="worktree of another commit, to compare with")
    parser.add_argument("--root", type=Path, help="where the made-up rows are kept; used again where they are there")
    parser.add_argument("--times", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = arguments.root or Path(folder) / "made-up"
        if not root.exists():
            write_made_up(root, max(1, round(SCENES * arguments.part)))
            # Tables that were written a moment ago are not kept.
            time.sleep(SETTLED_S)
        trees = {"here": Path(__file__).resolve().parents[1]}
        if arguments.against:
            trees["there"] = arguments.against.resolve()
        found: dict[tuple[str, str], list[Costs]] = {(name, kind): [] for name in trees for kind in KINDS}
        for number in range(arguments.times):
            for name, tree in trees.items():
                for kind in KINDS:
                    found[name, kind].append(opened(tree, root, Path(folder) / f"cache-{name}-{number}"))
    medians = {key: [statistics.median(column) for column in zip(*runs)] for key, runs in found.items()}
    for (name, kind), (opened_s, scene_s, most_mb, fingerprint_s) in medians.items():
        print(
            f"  {name:<6}{kind:<7}{opened_s:8.2f} s to open {scene_s:8.3f} s a scene {most_mb:8.0f} MB at most "
            f"{fingerprint_s:8.2f} s for the fingerprint"
        )
    if "there" in trees:
        ratio = medians["here", "first"][0] / medians["there", "first"][0]
        again = medians["there", "second"][0] / medians["here", "second"][0]
        print(f"opening costs {ratio:.2f} of what it did, {'within' if ratio <= MOST else 'PAST'} {MOST}")
        print(f"opening again is {again:.0f} times faster than it was")


if __name__ == "__main__":
    main()
