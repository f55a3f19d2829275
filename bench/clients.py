"""What py123d and trajdata read of an exported root (``data export nuscenes``), beside what its tables hold.

Run as ``python bench/clients.py``, with ``--data ROOT --split adv`` for scenes of one's own. The pins of the packages
clash with ours and with each other's: each gets an environment of its own below ``--folder`` (from PyPI, gigabytes,
made once), and reads the data set as it is, too. The exit code is 1 where a number of the exported root differs. The
figures: ``docs/extensions/exchange.md``.
"""

import argparse
import json
import subprocess
import sys
import venv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark import api
from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.errors import InputError
from benchmark.extensions.exchange.borrowed_names import VERSION_FOLDER, export_nuscenes
from benchmark.machine.storage import read_json
from benchmark.report.table import build_table

Counts = dict[str, int]


@dataclass(frozen=True, slots=True)
class Client:
    """A package that reads nuScenes roots; ``program`` gets a root and prints counts as JSON, last."""

    name: str
    requirements: tuple[str, ...]
    program: str


CLIENTS: Final = (
    Client(
        "py123d",
        ("py123d[nuscenes]==0.7.*",),
        """
import json, sys
from py123d.datatypes import BoxDetectionsSE3, Lane
from py123d.parser.nuscenes.nuscenes_parser import NuScenesParser
parser = NuScenesParser(["nuscenes_val"], nuscenes_data_root=sys.argv[1], nuscenes_map_root=sys.argv[1])
logs = parser.get_log_parsers()
frames = [frame for log in logs for frame in log.iter_modalities_sync()]
boxes = [each for frame in frames for each in frame.modalities if isinstance(each, BoxDetectionsSE3)]
maps = [any(isinstance(each, Lane) for each in road.iter_map_objects()) for road in parser.get_map_parsers()]
print(json.dumps({
    "scenes": len(logs), "frames": len(frames), "boxes": sum(len(each.box_detections) for each in boxes),
    "maps": sum(maps),
}))
""",
    ),
    Client(
        "trajdata",
        # Its own pins take releases that came later and break it.
        (
            "trajdata[nusc]==1.4.*",
            "torch==2.13.0",
            "numpy<2",
            "pandas<3",
            "pyarrow<20",
            "matplotlib<3.8",
            "opencv-python<5",
        ),
        """
import json, sys, tempfile
from pathlib import Path
from trajdata import MapAPI, UnifiedDataset
with tempfile.TemporaryDirectory() as folder:
    data = UnifiedDataset(
        ["nusc_trainval-val"], data_dirs={"nusc_trainval": sys.argv[1]}, cache_location=folder, num_workers=0,
        incl_vector_map=True, verbose=False,
    )
    scenes, maps = list(data.scenes()), MapAPI(Path(folder))
    found = [bool(maps.get_map(f"nusc_trainval:{city}").lanes) for city in sys.argv[2:]]
print(json.dumps({
    "scenes": len(scenes), "frames": sum(scene.length_timesteps for scene in scenes),
    "agents": sum(len(scene.agents) for scene in scenes), "maps": sum(found),
}))
""",
    ),
)


def count_root(root: Path) -> Counts:
    """What a reader should find: ``agents`` are egos, and people and vehicles of two boxes or more; maps have lanes."""

    def rows(table: str) -> list[dict[str, Any]]:
        content: list[dict[str, Any]] = read_json(root / VERSION_FOLDER / f"{table}.json")
        return content

    categories = {row["token"]: row["name"] for row in rows("category")}
    boxes = Counter(row["instance_token"] for row in rows("sample_annotation"))
    moving = [row for row in rows("instance") if categories[row["category_token"]].startswith(("human", "vehicle"))]
    maps = [read_json(root / "maps" / "expansion" / f"{city}.json") for city in OFFICIAL_LOCATIONS]
    return {
        "scenes": len(rows("scene")),
        "frames": len(rows("sample")),
        "boxes": boxes.total(),
        "agents": len(rows("scene")) + sum(boxes[row["token"]] > 1 for row in moving),
        "maps": sum(bool(layers["lane"]) for layers in maps),
    }


def make_environment(client: Client, folder: Path) -> Path:
    """Python of a client's environment, which is made where it is not complete; raises `InputError` if pip fails."""
    python, complete = folder / client.name / "bin" / "python", folder / client.name / ".complete"
    if not complete.is_file() or complete.read_text() != repr(client.requirements):
        print(f"installing {client.name} in {folder / client.name}", flush=True)
        venv.create(folder / client.name, with_pip=True, clear=True)
        done = subprocess.run([python, "-m", "pip", "install", "--quiet", *client.requirements], check=False)
        if done.returncode:
            raise InputError(f"pip cannot install {client.name} ({' '.join(client.requirements)}); see what it printed")
        complete.write_text(repr(client.requirements))
    return python


def read_root(python: Path, client: Client, root: Path) -> Counts | str:
    """What a client finds in a root, or the last line of its error."""
    done = subprocess.run(
        [python, "-I", "-c", client.program, root, *OFFICIAL_LOCATIONS], capture_output=True, text=True, check=False
    )
    if done.returncode:
        return (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    counts: Counts = json.loads(done.stdout.splitlines()[-1])
    return counts


def main(arguments: Sequence[str] | None = None) -> int:
    """Export, read, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default="mini", help="mini or the root of a data set")
    parser.add_argument("--split", default="adv")
    parser.add_argument("--folder", type=Path, default=Path("challenger-out") / "clients")
    chosen = parser.parse_args(arguments)
    data = api.open_split(api.open_data(chosen.data), chosen.split)
    try:
        (exported,) = export_nuscenes(data, data.scene_names(chosen.split), chosen.folder / "root")
        pythons = [make_environment(client, chosen.folder.absolute()) for client in CLIENTS]
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    expected, rows, same = count_root(exported.folder), [], True
    for client, python in zip(CLIENTS, pythons, strict=True):
        found, before = (read_root(python, client, root.resolve()) for root in (exported.folder, data.root))
        for counts, of in ((found, "the export"), (before, "the data set itself")):
            if isinstance(counts, str):
                print(f"{client.name} fails on {of}: {counts}")
        read, own = ({} if isinstance(each, str) else each for each in (found, before))
        rows += [
            (client.name, name, f"{expected[name]}", f"{read.get(name, '-')}", f"{own.get(name, '-')}")
            for name in (read or own or expected)
        ]
        same &= bool(read) and all(expected[name] == count for name, count in read.items())
    print(build_table("", "", ("reader", "what", "in tables", "read", "without export"), rows).plain())
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
