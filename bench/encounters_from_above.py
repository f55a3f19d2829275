"""Encounters of a record of drives as strips from above, to be looked at: one picture a drive.

    challenger-bench drive --agents adversary --split adv --model constant-velocity-on-path --no-baselines --out out
    python bench/encounters_from_above.py --record out/drives/mini/adv/WORLD/constant-velocity-on-path --to strips

Each strip has nine moments, evenly spread from the hand-over to the end of the drive: the adversary is orange, the ego
green, thick lines are the next 3 s, the pale dashes are the recorded path, and what the adversary considered is there
where it was kept (`drive --keep-considered`). The stored tracks are driven again, nobody searches. At the end it counts
how many poses of adversaries are off the road, and in how many drives.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import benchmark
from benchmark.closed_loop.engines import rides_as
from benchmark.machine.storage import file_name, write_bytes
from benchmark.records.drive_schema import AdversaryRow, DriveRow
from benchmark.records.drives import load_drives
from benchmark.report.birdseye import SceneFromAbove
from benchmark.report.canvas import png
from benchmark.report.captions import draw_scale_bar, draw_time
from benchmark.report.driven import DrivenSheet
from benchmark.report.lettering import Picture
from benchmark.report.palette import planner_style
from benchmark.runs.drive_sheets import driven_sheet
from benchmark.scene import Scene

COLUMNS: Final = 3
MOMENTS: Final = 9
SIDE_PX: Final = 420
EXTENT_M: Final = 32.0


def strip(driven: DrivenSheet, name: str) -> Picture:
    """(3 SIDE_PX, 3 SIDE_PX, 3) nine moments of a drive."""
    above, last = SceneFromAbove(driven.stored.sheet), driven.last
    assert driven.row.adversary is not None
    first = min(driven.begins, last)
    cells = []
    for frame in np.linspace(first, last, MOMENTS).round().astype(int).tolist():
        plan = driven.plan_at(frame, name, planner_style(0))
        considered = driven.candidates_at(frame)
        overlays = [driven.path(), *([] if plan is None else [plan]), *([] if considered is None else [considered])]
        image, view = above.draw(frame, overlays, width_px=SIDE_PX, height_px=SIDE_PX, extent_m=EXTENT_M, middle=0.6)
        draw_scale_bar(image, view)
        draw_time(image, float(driven.seconds[frame]))
        image[-1:], image[:, -1:] = 0, 0
        cells.append(image)
    rows = [np.concatenate(cells[at : at + COLUMNS], axis=1) for at in range(0, MOMENTS, COLUMNS)]
    return np.concatenate(rows)


def said(row: DriveRow) -> str:
    """What came of a drive."""
    contact = row.contact
    whom = "" if contact is None else " with the adversary" if contact.adversary else " with another"
    ended = "no contact" if contact is None else f"{contact.kind} contact{whom} after {contact.seconds:.1f} s"
    fault = ", at fault" if contact is not None and contact.at_fault else ""
    return f"{ended}{fault}, a careful human {'survives' if row.fair else 'does not survive'}"


def off_road(scene: Scene, adversary: AdversaryRow) -> int:
    """How many poses of an adversary have their centre off the drivable area."""
    poses = np.array(adversary.poses).reshape(-1, 3)
    return int((~scene.road_map.is_drivable(poses[:, :2])).sum())


def main() -> None:
    """See above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default="mini")
    parser.add_argument("--split", default="adv")
    parser.add_argument("--record", type=Path, required=True)
    parser.add_argument("--to", type=Path, help="nothing is drawn without it")
    chosen = parser.parse_args()
    record = load_drives(chosen.record)
    data = benchmark.open_split(benchmark.open_data(chosen.data), chosen.split)
    maker, counts = rides_as(record.facts.measured), []
    for row in record.rows:
        if row.adversary is None:
            continue
        scene = data.scene(row.scene)
        counts.append((off_road(scene, row.adversary), len(row.adversary.poses)))
        print(f"{row.scene} {row.run}: {said(row)}; off the road {counts[-1][0]} of {counts[-1][1]} poses")
        if chosen.to is not None:
            with tempfile.TemporaryDirectory() as folder:
                driven = driven_sheet(Path(folder), data, record, row, maker, None)
            write_bytes(chosen.to / f"{file_name(row.scene)}-{row.run}.png", png(strip(driven, record.planner)))
    off = [count for count, _ in counts if count]
    poses = sum(count for _, count in counts)
    print(f"{len(counts)} drives, {sum(off)} of {poses} poses off the road in {len(off)} drives")


if __name__ == "__main__":
    main()
