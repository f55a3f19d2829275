"""Files and commands: what the door costs, opening a data set, tables of many planners, refusals."""

import json
import os
import pickle
import random
import subprocess
import sys
import time
import warnings
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.speed.case import Case
from benchmark import api
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.storage import lock_folder, make_token
from benchmark.machine.user_cache import SETTLED_S
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord, write_record

GROWING = ("sample", "ego_pose", "sample_data", "instance", "sample_annotation", "calibrated_sensor", "scene")
"""Tables whose rows belong to one scene."""
_OF_THE_RECORD = ("schema_version", "status", "protocols", "seed", "files")
_OF_THE_SAMPLE = ("scene", "sample_token", "index", "timestamp_us", "complete", "recorded_future", "lidar_ahead_m")


def write_copies(source: Path, root: Path, copies: int) -> None:
    """Tables with the scenes of others so many times under other names; rows lie in no order within a copy."""
    (folder := root / "v1.0-trainval").mkdir(parents=True)
    (root / "maps").symlink_to(source / "maps")
    tables = {path.stem: json.loads(path.read_text()) for path in source.glob("v1.0-*/*.json")}
    own = {row["token"] for name in GROWING for row in tables[name]}
    for name, rows in tables.items():
        if isinstance(rows, dict):
            continue
        with (folder / f"{name}.json").open("w") as stream:
            for number in range(copies if name in GROWING else 1):
                stream.write(",\n" if number else "[\n")
                made = [
                    {
                        key: make_token("copy", number, value) if isinstance(value, str) and value in own else value
                        for key, value in row.items()
                    }
                    for row in rows
                ]
                if name == "scene":
                    made = [row | {"name": f"made-{number:04d}-{row['name']}"} for row in made]
                random.Random(number).shuffle(made)
                stream.write(",\n".join(json.dumps(row, indent=0) for row in made))
            stream.write("\n]")


def make_records(pattern: RunRecord, folder: Path, planners: int, samples: int) -> None:
    """Records of so many planners on so many samples, below a folder."""
    of_scene: dict[str, list[dict[str, Any]]] = {}
    for row in pattern.rows:
        of_scene.setdefault(row.scene, []).append(row.model_dump(mode="json"))
    kinds, facts = list(of_scene.values()), next(iter(pattern.run.scene_facts.values()))
    places = [(copy, kinds[copy % len(kinds)]) for copy in range(-(-samples // min(map(len, kinds))))]
    for number in range(planners):
        name, chance, rows = f"planner-{number:02d}", random.Random(number), []
        for copy, kind in places:
            scene, judged = f"made-{copy:04d}", chance.choice(kinds)
            for at, (place, verdict) in enumerate(zip(kind, judged)):
                own = {key: place[key] for key in _OF_THE_SAMPLE}
                own |= {"scene": scene, "sample_token": make_token("growth", copy, at)}
                rows.append(SampleRow.model_validate({**verdict, **own}))
        rows = rows[:samples]
        scenes = list(dict.fromkeys(row.scene for row in rows))
        described = {key: value for key, value in dict(pattern.run).items() if key not in _OF_THE_RECORD} | {
            "planner": pattern.run.planner.model_copy(update={"name": name}),
            "scenes": scenes,
            "scenes_in_split": len(scenes),
            "scene_facts": {scene: facts.model_copy(update={"source": scene}) for scene in scenes},
        }
        directory = folder / pattern.run.data.name / pattern.run.split / name
        with lock_folder(directory):
            write_record(directory, described, rows, pattern.run.protocols, seed=0)


def checkpoint(quick: bool, folder: Path) -> Path:
    """As mmcv writes them: weights, and moments of an optimizer that are twice as large."""
    import torch

    tensors = 12 if quick else 128
    generator = torch.Generator().manual_seed(0)
    weights = [torch.randn(2048, 2048, generator=generator) for _ in range(tensors // 3)]
    moments = {number: {"exp_avg": weight + 1, "exp_avg_sq": weight * weight} for number, weight in enumerate(weights)}
    held = {f"layers.{number}.weight": weight for number, weight in enumerate(weights)}
    torch.save(
        {"meta": {"epoch": 1}, "state_dict": held, "optimizer": {"state": moments}}, path := folder / "large.pth"
    )
    return path


def recording(_quick: bool, folder: Path) -> Path:
    """As many objects and steps as a crowded scene of nuScenes has."""
    rng = np.random.default_rng(0)
    tracks = {str(number): {"position": rng.standard_normal((200, 3)), "type": "VEHICLE"} for number in range(300)}
    (path := folder / "recording.pkl").write_bytes(pickle.dumps(tracks))
    return path


def in_a_process(words: list[str], cache: Path, wanted: int = 0) -> float:
    """Seconds on the clock of a command in a process of its own; what it computes is counted as ours."""
    started = time.perf_counter()
    environment = {**os.environ, "CHALLENGER_BENCH_CACHE": str(cache)}
    command = [sys.executable, "-m", "benchmark", *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != wanted:
        raise RuntimeError(f"{' '.join(words[:2])} ended with {done.returncode}: {done.stderr[-500:]}")
    return time.perf_counter() - started


def checkpoint_through_the_door(path: Path) -> tuple[float, float]:
    import torch

    from benchmark.weights.folders import read_checkpoint

    return 1, sum(float(tensor.sum(dtype=torch.float64)) for tensor in read_checkpoint(path).tensors.values())


def checkpoint_before(path: Path) -> tuple[float, float]:
    """Checksums, then PyTorch's weights-only reader, mapped: the sum of all numbers that are asked for."""
    import torch

    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        tensors = torch.load(path, map_location="cpu", weights_only=True, mmap=True)["state_dict"]
    return 1, sum(float(tensor.sum(dtype=torch.float64)) for tensor in tensors.values())


def recording_through_the_door(path: Path) -> tuple[float, float]:
    from benchmark.untrusted.children import read_pickle

    return 1, float(sum(track["position"].sum() for track in read_pickle(path).values()))


def recording_before(path: Path) -> tuple[float, float]:
    """In this process, with the allow-list alone."""
    from benchmark.untrusted.legacy_storages import AllowListUnpickler

    with path.open("rb") as stream:
        return 1, float(sum(track["position"].sum() for track in AllowListUnpickler(stream).load().values()))


def made_up_root(part: float, quick: bool, folder: Path) -> tuple[Path, Path]:
    source = Path(api.open_data("mini").root)
    # As many rows of sensors as trainval has, with 157 copies.
    write_copies(source, folder / "root", 1 if quick else round(157 * part))
    # Tables that were written a moment ago are not kept.
    time.sleep(SETTLED_S)
    opening((folder / "root", folder), kept=True)
    return folder / "root", folder


def cache_of(folder: Path, *, kept: bool) -> Path:
    """The cache that is kept, or an empty one."""
    return folder / "kept" if kept else folder / f"empty-{time.monotonic_ns()}"


def opening(state: Any, *, kept: bool, fingerprint: bool = False) -> tuple[float, Any]:
    from benchmark.datasets.nuscenes import NuScenesData

    os.environ["CHALLENGER_BENCH_CACHE"] = str(cache_of(state[1], kept=kept))
    data = NuScenesData.open(state[0])
    assert type(data._tables).__name__ == "SceneByScene"
    if fingerprint:
        data.fingerprint()
    return 1, data


def time_per_scene(_state: Any, data: Any) -> str:
    started = time.process_time()
    for name in data.scene_names()[:3]:
        data.scene(name)
    return f"then {(time.process_time() - started) / 3:.3f} s per scene"


def records_of_many(planners: int, samples: int, site: bool, quick: bool, folder: Path) -> tuple[Path, bool]:
    """Made from a baseline's record on the embedded data set; each planner has the verdicts of other scenes."""
    data = api.open_split(api.open_data("mini", workers=1), "val", folder, workers=1)
    pattern = evaluate(data, "val", api.load_planner("constant-velocity"), folder / "pattern", EvalSettings())
    make_records(pattern, folder / "runs", *((2, 40) if quick else (planners, samples)))
    leaderboard((folder, site), kept=True)
    return folder, site


def leaderboard(state: Any, *, kept: bool) -> tuple[float, Any]:
    folder, site = state
    words = [
        "leaderboard",
        "--records",
        f"{folder / 'runs'}",
        "--out",
        f"{folder / 'table'}",
        *["--no-site"] * (not site),
    ]
    return 1, in_a_process(words, cache_of(folder, kept=kept)) and None


def leaderboard_case(planners: int, samples: int, *, site: bool = False, on_request: bool = False) -> Case:
    return Case(
        f"leaderboard/{planners}x{samples}{'-site' * site}",
        f"`leaderboard` of {planners} planners on {samples} samples again, beside the first time, with an empty cache.",
        partial(records_of_many, planners, samples, site),
        partial(leaderboard, kept=True),
        "table",
        other=("the first time", partial(leaderboard, kept=False)),
        on_request=on_request,
    )


def wrong_commands(quick: bool, folder: Path) -> tuple[list[str], Path]:
    """The first of each group of the commands that are refused."""
    from tests.benchmark.cli.refusals import WRONG

    (folder / "file").write_text("none")
    (folder / "plans.csv").write_text("")
    (folder / "empty").mkdir()
    firsts: dict[str, str] = {}
    for words, _ in WRONG:
        firsts.setdefault(words.split()[0], words)
    return list(firsts.values())[: 2 if quick else None], folder


def refuse(state: Any) -> tuple[float, Any]:
    """Seconds of the slowest, and which it is."""
    commands, folder = state
    places = {name: str(folder / name) for name in ("new", "file", "empty")} | {"csv": str(folder / "plans.csv")}
    spent = [(in_a_process(words.format(**places).split(), folder / "cache", 2), words) for words in commands]
    return len(commands), max(spent)


CASES = (
    Case(
        "door/checkpoint",
        "A checkpoint of 2 GB read through the door, as mmcv writes them: weights, and moments twice as large.",
        checkpoint,
        checkpoint_through_the_door,
        "file",
        other=("as before the door", checkpoint_before),
        same=lambda _, one, other: one == other,
        wall=True,
        least_ratio=1 / 1.3,
    ),
    Case(
        "door/recording",
        "A recording with as many objects and steps as a crowded scene of nuScenes, read through the door.",
        recording,
        recording_through_the_door,
        "file",
        other=("with the allow-list alone", recording_before),
        same=lambda _, one, other: one == other,
        wall=True,
    ),
    *(
        Case(
            f"opening/{name}",
            f"Opening {what} of nuScenes trainval's rows {when}.",
            partial(made_up_root, part),
            partial(opening, kept=name != "first"),
            "opening",
            other=(beside, partial(opening, kept=False, fingerprint=name == "first")),
            more=time_per_scene,
            needs=("nuscenes",),
            on_request=name == "whole",
        )
        for name, part, what, when, beside in (
            ("part", 0.02, "a fiftieth", "again, beside the first time", "the first time"),
            ("whole", 1.0, "all (3 GB)", "again, beside the first time", "the first time"),
            (
                "first",
                0.02,
                "a fiftieth",
                "the first time, beside doing so and taking the fingerprint",
                "with the fingerprint",
            ),
        )
    ),
    leaderboard_case(10, 400),
    leaderboard_case(10, 2000),
    leaderboard_case(20, 400),
    *(leaderboard_case(planners, 6019, on_request=True) for planners in (20, 50)),
    *(leaderboard_case(4, samples, site=True, on_request=True) for samples in (1600, 6400)),
    Case(
        "refusals",
        "A wrong argument refused, one of each group of commands, as a user meets it.",
        wrong_commands,
        refuse,
        "command",
        more=lambda _, slowest: f"slowest {slowest[0]:.2f} s: {slowest[1]}",
        wall=True,
        most_s=2.0,
    ),
)
