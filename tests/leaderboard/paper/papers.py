"""A leaderboard with everything that the paper's tables need."""

from dataclasses import replace
from pathlib import Path

from benchmark.records.run import RunRecord
from benchmark.records.scene_pages import ScenePages
from tests.benchmark.records.hand_made_records import CLEAN, HIT, LATE, hand_made
from tests.leaderboard.made_up import ATTEMPTS, RUNTIME, STATISTICS, sheets_of, split_sheet

OWN = {"uniad": "uniad", "vad-base": "vad", "sparsedrive": "sparsedrive", "diffusiondrive": "diffusiondrive"}
AS_PRINTED = {
    "init_scale": 1e-3, "corner_weight": 0.2, "horizon": 12, "road_and_collision_last_weight": 0.85,
    "challenge_first_weight": 0.7, "dac_weight": 5.0, "cr_weight": 10.0, "ac_weight": 1.0, "temperature": 1.0,
    "rounds": 5,
}  # fmt: skip


def paper_runs(data: str = "d") -> list[RunRecord]:
    """The paper's four planners and two without a protocol of their own, on three splits."""
    runs = []
    for place, (planner, own) in enumerate({**OWN, "constant-velocity": "exact", "idm": "exact"}.items()):
        for split, flags in (("val", CLEAN), ("val-r", LATE), ("adv", HIT)):
            scenes = {f"s{number}": [CLEAN, flags if number <= place else CLEAN, LATE] for number in range(8)}
            native = own if planner in OWN else None
            made = hand_made(planner, scenes, split=split, protocols=("exact", *OWN.values()), native=native, data=data)
            runs.append(replace(made, directory=Path(data) / split / planner))
    return runs


def paper_sheets(data: str = "d") -> ScenePages:
    """A recorded split, and one that was searched with the settings that the paper prints, but for the rounds."""
    adv = split_sheet("adv", data=data, statistics=STATISTICS, runtime=RUNTIME, attempts=ATTEMPTS)
    searched = adv.model_copy(update={"hyper": {**AS_PRINTED, "rounds": 7}})
    return sheets_of(searched, split_sheet("val", data=data))
