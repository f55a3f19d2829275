"""Reading golden sets of result files: what an importer must know, and what must come out of each file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.result_files.samples import RecordedSamples
from benchmark.constants import PLAN_STEPS
from benchmark.errors import InputError
from benchmark.extensions.golden_sets.protocols.arrays import ProtocolArrays
from benchmark.extensions.golden_sets.protocols.golden_set import truths_of
from benchmark.truth import SampleTruth
from benchmark.untrusted.json_text import read_json
from benchmark.verification.golden import GoldenArrays, golden_directory

FACTS, MANIFEST, PROTOCOLS = "facts.npz", "manifest.json", "protocols"


@dataclass(frozen=True, slots=True)
class GoldenFile:
    """One file of a set.

    Attributes:
        name: Its name.
        path: File or folder.
        stored: What the manifest says of it.
    """

    name: str
    path: Path
    stored: dict[str, Any]

    @property
    def accepted(self) -> bool:
        """Whether it must be read."""
        return bool(self.stored["outcome"] == "accept")

    @property
    def categories(self) -> tuple[str, ...]:
        """Why it may be refused, if it must be."""
        return (str(self.stored["category"]), *map(str, self.stored.get("also_ok", ())))

    def tolerance(self, array: str) -> float:
        """How much numbers may differ, metres."""
        allowed = self.stored["compare"][array]
        return float(allowed["tolerance"] if isinstance(allowed, dict) else allowed)


@dataclass(frozen=True, slots=True)
class GoldenResults:
    """A set.

    Attributes:
        samples: What an importer must know.
        commands: (S,) stored driving commands.
        index_in_scene: (S,) number of the sample in its scene.
        files: Every file.
        folder: Of the set.
    """

    samples: RecordedSamples
    commands: NDArray[np.int64]
    index_in_scene: NDArray[np.int64]
    files: tuple[GoldenFile, ...]
    folder: Path

    def truths(self) -> dict[str, list[SampleTruth]]:
        """What happened in each scene, by its name, from the set ``protocols`` beside this one; only scenes there."""
        found = {}
        for scene in sorted(set(self.samples.scenes)):
            path = self.folder.resolve().parent / PROTOCOLS / f"{scene}.npz"
            if path.is_file():
                count = int(self.index_in_scene[np.array(self.samples.scenes) == scene].max()) + 1
                stored = ProtocolArrays.read(path)
                samples = len(stored.floats("ego_fut", None, PLAN_STEPS, 3))
                if samples >= count:
                    found[scene] = truths_of(stored, samples)
        return found


def read_golden_results(golden: Path) -> GoldenResults:
    """Read a set.

    Args:
        golden: Its folder.

    Returns:
        The set.

    Raises:
        InputError: If it is absent, or something in it is broken.
    """
    folder = golden_directory(golden, "result_files", FACTS, MANIFEST)
    stored = GoldenArrays.read(folder / FACTS)
    tokens = stored.texts("token")
    count = len(tokens)
    mount = [*stored.floats("lidar_to_ego_translation", 3)[:2], float(stored.floats("lidar_to_ego_yaw"))]
    samples = RecordedSamples(
        name=f"the set {folder.name}",
        tokens=tuple(tokens),
        scenes=tuple(stored.texts("scene", count)),
        timestamps_us=stored.integers("timestamp", count),
        ego_pose=stored.floats("ego_pose", count, 3),
        lidar_in_ego=np.tile(mount, (count, 1)),
        future=stored.floats("ego_future_lidar", count, PLAN_STEPS, 3)[..., :2],
        valid=stored.verdicts("ego_future_valid", count, PLAN_STEPS),
        by_time=_places(stored, "order_infos_timestamp", count),
        by_table=_places(stored, "order_infos_scene", count),
    )
    index = stored.integers("index_in_scene", count)
    return GoldenResults(samples, stored.integers("command", count), index, _files(folder), folder)


def _places(stored: GoldenArrays, name: str, count: int) -> NDArray[np.int64]:
    places = stored.integers(name, None)
    if len(set(places.tolist())) < len(places) or places.min(initial=0) < 0 or places.max(initial=-1) >= count:
        raise InputError(f"array {name} in {stored.path} is no order of its {count} samples; make the file again")
    return places


def _files(folder: Path) -> tuple[GoldenFile, ...]:
    path = folder / MANIFEST
    stored = read_json(path)
    entries = stored.get("files") if isinstance(stored, dict) else None
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path} lists no files; fetch the set again")
    found = []
    for entry in entries:
        try:
            file = GoldenFile(str(entry["name"]), folder / entry["path"], entry)
            if not file.path.resolve().is_relative_to(folder.resolve()):
                raise InputError(f"{path} names {entry['path']}, which leaves the set; correct it")
            if file.accepted:
                _ = [file.tolerance(array) for array in ("plan", "plan_lidar", "plan_ego")]
                _ = [entry[key] for key in ("expected", "format", "frame", "order", "skipped", "plans", "waypoints")]
            else:
                _ = file.categories
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"{path} does not say what must come out of each file ({error}); fetch it again"
            ) from error
        found.append(file)
    return tuple(found)
