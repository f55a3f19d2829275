"""How commands grow with samples and planners: processor seconds and most memory, of made-up records.

Run as ``OMP_NUM_THREADS=1 python bench/growth.py``. Each command runs with an empty cache (``first``) and then again,
with what the first one kept there, which is what `eval` keeps as well (``again``); ``--start WORKTREE`` runs it in
another tree too, with an empty cache, and prints ratios. ``--folder`` keeps the records for another call. Records are
made from those of a baseline on the embedded data set: scenes are copied under other names, and each planner gets the
verdicts of other scenes, so that planners differ. No planner runs at size.
"""

import argparse
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark import api
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.storage import only_writer, token
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord, write_record

ROOT = Path(__file__).resolve().parents[1]
SPLIT = "val"
_OF_THE_SAMPLE = ("scene", "sample_token", "index", "timestamp_us", "complete", "recorded_future", "lidar_ahead_m")


def template(folder: Path) -> RunRecord:
    """A baseline's record on the embedded data set."""
    data = api.open_split(api.open_data("mini", workers=1), SPLIT, folder, workers=1)
    return evaluate(data, SPLIT, api.load_planner("constant-velocity"), folder, EvalSettings())


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
                own |= {"scene": scene, "sample_token": token("growth", copy, at)}
                rows.append(SampleRow.model_validate({**verdict, **own}))
        rows = rows[:samples]
        scenes = list(dict.fromkeys(row.scene for row in rows))
        described = {
            key: value
            for key, value in dict(pattern.run).items()
            if key not in {"schema_version", "status", "protocols", "seed", "files"}
        }
        described |= {
            "planner": pattern.run.planner.model_copy(update={"name": name}),
            "scenes": scenes,
            "scenes_in_split": len(scenes),
            "scene_facts": {scene: facts.model_copy(update={"source": scene}) for scene in scenes},
        }
        directory = folder / pattern.run.data.name / SPLIT / name
        with only_writer(directory):
            write_record(directory, described, rows, pattern.run.protocols, seed=0)


def measured(tree: Path, command: Sequence[str], cache: Path) -> tuple[float, float]:
    """Processor seconds and most megabytes of a command of a tree and of its workers, with this cache."""
    program = (
        "import json, resource, sys\n"
        "from benchmark.cli.app import main\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n"
        "    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))\n"
        "    spent = sum(each.ru_utime + each.ru_stime for each in (own, others))\n"
        "    most = max(own.ru_maxrss, others.ru_maxrss) / 1024\n"
        "    print(json.dumps([end.code, spent, most]), file=sys.stderr)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "CHALLENGER_BENCH_CACHE": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", program, *command],
        cwd=tree,
        env=environment,
        text=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        check=False,
    )
    code, spent_s, most_mb = json.loads(done.stderr.strip().splitlines()[-1])
    if code:
        raise SystemExit(f"{' '.join(command)} ended with {code}:\n{done.stderr[-2000:]}")
    return spent_s, most_mb


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sizes", nargs="*", default=["10x400", "10x2000", "20x400"], help="planners x samples")
    parser.add_argument("--start", type=Path, help="worktree of another commit, to compare with")
    parser.add_argument("--site", action="store_true", help="with the site")
    parser.add_argument("--folder", type=Path, help="where records are made, and found again by another call")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder, caches = arguments.folder or Path(scratch), Path(scratch) / "caches"
        missing = [size for size in arguments.sizes if not (folder / size / "runs").is_dir()]
        if missing:
            pattern = template(folder / "pattern")
            os.environ["CHALLENGER_BENCH_CACHE"] = str(caches / "making")
        for size in arguments.sizes:
            records = (folder / size / "runs").resolve()
            if size in missing:
                planners, samples = map(int, size.split("x"))
                make_records(pattern, records, planners, samples)
            command = ["leaderboard", "--records", str(records), "--out", str(Path(scratch) / size)]
            command += [] if arguments.site else ["--no-site"]
            runs = {"first": ROOT, "again": ROOT}
            runs |= {} if arguments.start is None else {"start": arguments.start.resolve()}
            found: dict[str, tuple[float, float]] = {}
            for name, tree in runs.items():
                found[name] = spent_s, most_mb = measured(tree, command, caches / f"{size}-{tree == ROOT}")
                print(
                    f"leaderboard {size:>10} {name:<6}{spent_s:9.1f} s of processor time {most_mb:8.0f} MB", flush=True
                )
            for name in ("first", "again") if "start" in found else ():
                seconds, memory = (found["start"][part] / found[name][part] for part in (0, 1))
                print(f"leaderboard {size:>10} start/{name} {seconds:5.2f} times the time, {memory:5.2f} the memory")


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    main()
