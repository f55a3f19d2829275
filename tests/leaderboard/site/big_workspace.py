"""A workspace of any size with run records and scene sheets, made without running a planner or drawing a camera."""

import dataclasses
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmark.machine.storage import content_key, content_seed, file_sha256, make_token, write_json
from benchmark.machine.workspace import Workspace
from benchmark.planning import PlanFrame
from benchmark.records.run_schema import DataFacts, PlannerFacts
from benchmark.records.scene_pages import (
    CAMERA_GRID,
    SCHEMA,
    SHEET_FILE,
    SPLIT_FILE,
    AttemptFacts,
    SplitPage,
    picture_name,
    scene_folder,
    split_folder,
)
from benchmark.records.statistics import ManoeuvreRow, Quantiles, SplitStatistics, TableCounts
from benchmark.runs.run_directory import run_directory
from tests.leaderboard.site.made_runs import MadePlanner, run, truth_of
from tests.leaderboard.site.made_scenes import (
    CELL_HEIGHT_PX,
    CELL_WIDTH_PX,
    MadeScene,
    labels_of,
    make_scene,
    sheet_of,
)

IMAGE_TAG = "<img src=x onerror=alert(1)>"
SCRIPT_TAG = "</script><script>alert(2)</script>"
QUOTES = 'it\'s "quoted" & <b>bold</b> \\ `tick` ${1}'
EMOJI = "🚗💥 scene"
RIGHT_TO_LEFT = "\u202eenecs سيارة"
LONG = "long-" + "x" * 195
DOTS = "../.."
HOSTILE_NAMES = (SCRIPT_TAG, DOTS, QUOTES, RIGHT_TO_LEFT, LONG, EMOJI)
"""Names that scenes get, after the first."""
HOSTILE_REASON = "<svg onload=alert(3)>"
HOSTILE_DESCRIPTION = "day, <iframe src=javascript:alert(4)></iframe> %s {{7*7}} 'x'"
DATA_NAME = "made up"
REASONS = ("hits-an-object", "hits-the-ego", "never-gets-close", "leaves-the-drivable-area")
AGENTS = 30
_QUANTILES = ("least", "tenth", "median", "ninetieth", "most")


@dataclass(frozen=True, slots=True)
class BigWorkspace:
    """What was made."""

    out: Path
    planners: tuple[str, ...]
    adversarial: tuple[str, ...]
    recorded: tuple[str, ...]
    without_sheet: str

    @property
    def scenes(self) -> tuple[str, ...]:
        """All scene names."""
        return (*self.adversarial, *self.recorded)


def make_workspace(
    folder: Path,
    scenes: int = 150,
    models: int = 10,
    seed: int = 0,
    *,
    samples: int = 40,
    hostile: bool = True,
    cell_width_px: int = CELL_WIDTH_PX,
) -> BigWorkspace:
    """Write run records and sheets of two splits, ``adv`` and the recordings ``val`` that it was made from."""
    space = Workspace(folder)
    for old in (space.run_root(), space.sheet_root()):
        shutil.rmtree(old, ignore_errors=True)
    recorded = max(1, scenes // 3)
    sources = [f"scene-{1000 + number}" for number in range(recorded)]
    names = _adversarial_names(sources, scenes - recorded, hostile)
    made = {
        "adv": [
            _scene(name, sources[number % recorded], samples, seed, hostile and number == 1, adversarial=True)
            for number, name in enumerate(names)
        ],
        "val": [_scene(name, name, samples, seed, False, adversarial=False) for name in sources],
    }
    planners = made_planners(models, hostile=hostile)
    for split, found in made.items():
        data = DataFacts(name=DATA_NAME, version="v1.0-made", fingerprint=content_key("made data", split, seed))
        shown = found if split == "adv" else found[:-1]
        _write_sheets(space.sheet_root(), data, split, found, shown, cell_width_px)
        truths = [truth_of(scene) for scene in found]
        for planner in planners:
            identity = PlannerFacts(name=planner.name, privileged=planner.privileged)
            run(run_directory(space.run_root(), DATA_NAME, split, identity), planner, data, split, truths, seed=seed)
    return BigWorkspace(folder, tuple(planner.name for planner in planners), tuple(names), tuple(sources), sources[-1])


def made_planners(count: int, *, hostile: bool = True) -> list[MadePlanner]:
    """Planners from sleepy to alert; the first fails now and then, the second forecasts in the lidar's frame."""
    natives = ("vad", "uniad", None, "sparsedrive", "diffusiondrive")
    planners = [
        MadePlanner(
            name=f"planner-{number:02d}",
            native=natives[number % len(natives)],
            privileged=number % 5 == 4,
            frame=PlanFrame.LIDAR if number % 2 else PlanFrame.EGO,
            alertness=round(0.15 + 0.8 * number / max(count - 1, 1), 3),
            unsteadiness_m=round(0.3 + 1.5 * (count - number) / count, 3),
            forecasts=number % 5 in (0, 1, 3),
            failing=0.03 if number == 0 else 0.0,
        )
        for number in range(count)
    ]
    if hostile and count > 2:
        planners[2] = dataclasses.replace(planners[2], name=IMAGE_TAG)
    return planners


def _adversarial_names(sources: Sequence[str], count: int, hostile: bool) -> list[str]:
    names = [f"{sources[number % len(sources)]}-{make_token('made', number)[:8]}" for number in range(count)]
    if hostile:
        bad = HOSTILE_NAMES[: max(count - 1, 0)]
        names[1 : 1 + len(bad)] = bad
    return names


def _scene(name: str, source: str, samples: int, seed: int, hostile: bool, *, adversarial: bool) -> MadeScene:
    said = HOSTILE_DESCRIPTION if hostile else "Made up, day" if adversarial else "Made up, night, rain"
    return make_scene(
        name, source, adversarial=adversarial, agents=AGENTS, samples=samples, description=said, seed=seed
    )


def _write_sheets(
    root: Path,
    data: DataFacts,
    split: str,
    found: Sequence[MadeScene],
    shown: Sequence[MadeScene],
    cell_width_px: int,
) -> None:
    for scene in shown:
        directory = scene_folder(root, data.name, split, scene.name)
        pictures = {}
        for number, frame in enumerate(scene.keyframes):
            path = directory / picture_name(frame)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(_picture(number, cell_width_px))
            pictures[picture_name(frame)] = file_sha256(path)
        sheet = sheet_of(scene, data, split, pictures)
        write_json(directory / SHEET_FILE, sheet.model_dump(mode="json", by_alias=True), indent=None)
    statistics = _statistics(split, found)
    about = SplitPage(
        schema=SCHEMA,
        data=data,
        split=split,
        scenes=tuple(scene.name for scene in found),
        statistics=statistics,
        attempts=_attempts(found) if split == "adv" else (),
    )
    write_json(split_folder(root, data.name, split) / SPLIT_FILE, about.model_dump(mode="json", by_alias=True))


@cache
def _picture(number: int, cell_width_px: int) -> bytes:
    """Six cells of different colours with the number of the sample in each."""
    height, width = round(cell_width_px * CELL_HEIGHT_PX / CELL_WIDTH_PX), cell_width_px
    ramp = np.linspace(60, 200, width, dtype=np.uint8)
    picture = np.empty((2 * height, 3 * width, 3), np.uint8)
    for row, names in enumerate(CAMERA_GRID):
        for column in range(len(names)):
            cell = picture[row * height : (row + 1) * height, column * width : (column + 1) * width]
            cell[:] = np.roll(ramp, 7 * number)[None, :, None]
            cell[..., (row + column) % 3] //= 2
            cv2.putText(cell, str(number), (4, height - 8), cv2.FONT_HERSHEY_SIMPLEX, height / 60, (255, 255, 255), 1)
    done, encoded = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, 80])
    assert done
    return encoded.tobytes()


def _attempts(scenes: Sequence[MadeScene]) -> tuple[AttemptFacts, ...]:
    """For each scene the car that became it, and three that did not."""
    found = []
    for number, scene in enumerate(scenes):
        kept = AttemptFacts(
            source=scene.source,
            agent=scene.agent(AGENTS - 1),
            scene=scene.name,
            discarded=None,
            manoeuvre=scene.manoeuvre,
        )
        reasons = [REASONS[content_seed(scene.name, tried) % len(REASONS)] for tried in range(3)]
        if number == 1 and scene.name in HOSTILE_NAMES:
            reasons[0] = HOSTILE_REASON
        found += [
            kept,
            *(
                AttemptFacts(
                    source=scene.source, agent=scene.agent(tried), scene=None, discarded=reason, manoeuvre=None
                )
                for tried, reason in enumerate(reasons)
            ),
        ]
    return tuple(found)


def _statistics(split: str, scenes: Sequence[MadeScene]) -> SplitStatistics:
    labels: list[dict[str, Any]] = [found for found in map(labels_of, scenes) if found is not None]
    samples = sum(len(scene.keyframes) for scene in scenes)
    kinds = Counter(found["manoeuvre"] for found in labels)
    places = Counter(found["place"] for found in labels)
    return SplitStatistics(
        split=split,
        counts=TableCounts(
            instances=AGENTS * len(scenes),
            ego_poses=42 * samples,
            scenes=len(scenes),
            samples=samples,
            sample_data=42 * samples,
            annotations=AGENTS * samples,
        ),
        adversaries_per_scene={1: len(scenes)} if labels else {},
        labelled=len(labels),
        manoeuvres=tuple(
            ManoeuvreRow(
                manoeuvre=kind,
                primary=count,
                occurred=count,
                places=dict(sorted(Counter(found["place"] for found in labels if found["manoeuvre"] == kind).items())),
                median_gap_m=0.4,
            )
            for kind, count in sorted(kinds.items(), key=lambda item: (-item[1], item[0]))
        ),
        places=dict(sorted(places.items())),
        gap_m=Quantiles(**dict.fromkeys(_QUANTILES, 0.4)) if labels else None,
        time_to_collision_s=Quantiles(**dict.fromkeys(_QUANTILES, 0.9)) if labels else None,
        within_5_s=len(labels),
    )
