"""How far planners get when they are driven: the figures of closed loop that `docs/miniatures.md` is measured against.

Run ``challenger-bench drive --model vad-mini --sensor schematic --split val`` first, then
``python bench/miniatures_driven.py FOLDER ...`` with the folders of its records of drives. *Completed*: to the end of
the scene without a contact that ends the drive and never off the road, with at least 80 % of the recorded way. *Clear*:
metres along the route before such a contact and before the ego first leaves the road; mean over the drives. What ends a
drive is any contact, or with ``--until fault`` one that is the ego's fault; contacts are counted whoever's they are.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmark.records.drive_schema import DriveRow
from benchmark.records.drives import load_drives

LEAST_WAY = 0.8
"""Of the recorded way, in a drive that counts as completed."""


def left_road_s(row: DriveRow) -> float | None:
    """When the ego first leaves the road, if it does."""
    assert row.scores is not None and row.scores.nuplan is not None, "drives of the default engine that did not fail"
    return row.scores.nuplan.off_road_s


def clear_m(row: DriveRow) -> float:
    """Metres along the route before anything went wrong."""
    assert row.scores is not None
    seconds = left_road_s(row)
    if seconds is None:
        return row.scores.progress_m
    station = row.ticks.station
    elapsed = (np.array(row.ticks.time_us[: len(station)]) - row.ticks.time_us[0]) / 1e6
    return min(row.scores.progress_m, float(np.interp(seconds, elapsed, station)) - station[0])


def completed(row: DriveRow) -> bool:
    """Whether a drive came through."""
    assert row.scores is not None
    share = row.scores.route_share
    return row.contact is None and left_road_s(row) is None and (share is None or share >= LEAST_WAY)


def main(folders: tuple[Path, ...]) -> None:
    """Print one line for each record."""
    for folder in folders:
        record = load_drives(folder)
        rows = [row for row in record.rows if row.scores is not None]
        contacts = [row.first_contact for row in rows if row.first_contact is not None]
        blamed = sum(row.contact is not None and row.contact.at_fault for row in rows)
        strayed = sum(left_road_s(row) is not None for row in rows)
        print(
            f"{record.planner} on {record.facts.split}, {record.facts.measured.world}: completed "
            f"{sum(map(completed, rows))} of {len(record.rows)}; contacts {len(contacts)}, at fault "
            f"{blamed}; off the road {strayed}; clear "
            f"{np.mean([clear_m(row) for row in rows]):.0f} m"
        )


if __name__ == "__main__":
    main(tuple(Path(each) for each in sys.argv[1:]))
