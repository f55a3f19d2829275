"""Exporting the scenes of a data set, each to a file of its own: what is common to all formats, and ScenarioNet's."""

import io
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import VERSION
from benchmark.datasets.own_words import DATASET, OWN, Exchanged
from benchmark.datasets.roots import DataSet
from benchmark.datasets.steps import require_two_hz
from benchmark.errors import InputError
from benchmark.extensions.exchange.scenario_of_scene import scenario_of
from benchmark.machine.progress import Count
from benchmark.machine.storage import only_writer, token, write_bytes
from benchmark.machine.workers import map_ordered
from benchmark.scene import Scene

SUMMARY: Final = "dataset_summary.pkl"
MAPPING: Final = "dataset_mapping.pkl"
"""What ScenarioNet and MetaDrive look for in a folder: metadata by file, and the folder of each file."""
_PROTOCOL: Final = 4
"""Of pickles, as ScenarioNet writes them; Python 3.4 reads it."""


@dataclass(frozen=True, slots=True)
class ExportedScene:
    """One file: its path, the scene's name in it, and who is adversarial."""

    path: Path
    scene: str
    adversaries: tuple[str, ...]


def exchanged_of(dataset: DataSet, name: str) -> Exchanged:
    """A scene of a data set with its recorded scene and the report of its making, where the data set has them.

    In variant roots (``v0/scene-0061``) the name becomes one for a file (``scene-0061-v0``), and identifiers of objects
    become other ones, since variants share theirs.
    """
    scene = dataset.scene(name)
    require_two_hz(scene, "an exchanged file")
    said = ((dataset.provenance() or {}).get("scenes") or {}).get(name, {})
    report = said.get("report") if isinstance(said, dict) else None
    facts = dataset.scene_facts([name])[name]
    if "/" in name:
        variant, _, inner = name.partition("/")
        scene = _as_variant(scene, f"{inner}-{variant}")
    return Exchanged(scene, facts.source or scene.name, report if isinstance(report, dict) else {})


def _as_variant(scene: Scene, name: str) -> Scene:
    """The scene of a variant root as it would be called in one root of all variants."""
    called = {identifier: token("instance", name, identifier) for identifier in scene.agents.ids}
    return replace(
        scene,
        name=name,
        agents=replace(scene.agents, ids=tuple(called.values())),
        adversaries=tuple(called[identifier] for identifier in scene.adversaries),
    )


def export_scenarionet(dataset: DataSet, names: Sequence[str], to: Path, *, workers: int) -> tuple[ExportedScene, ...]:
    """Write scenes as ScenarioNet files, which MetaDrive and ScenarioNet open.

    Args:
        dataset: The data set.
        names: Its scenes.
        to: Folder; gets a file a scene, ``dataset_summary.pkl`` and ``dataset_mapping.pkl``.
        workers: Number of processes; the bytes are the same with any.

    Returns:
        What was written.

    Raises:
        InputError: If a scene is broken, or the folder holds other scenarios or cannot be written.
    """
    with only_writer(to):
        files = export_scenes(names, to, "pkl", partial(_write_scenario, dataset, to), workers=workers)
        summary = {written.path.name: metadata for written, metadata in files}
        write_bytes(to / SUMMARY, plain_pickle(summary))
        write_bytes(to / MAPPING, plain_pickle(dict.fromkeys(summary, "")))
    return tuple(written for written, _ in files)


def export_scenes(
    names: Sequence[str], to: Path, ending: str, write: Callable[[str], Any], *, workers: int
) -> list[Any]:
    """Write a file a scene, all with the same ending, to a folder that holds no others.

    Returns:
        The results of ``write``, in the order of the names.
    """
    if not names:
        raise InputError("there is no scene to export; name one with --scenes, or leave --scenes and --limit out")
    own = {scene_file(to, name, ending).name for name in names}
    others = sorted(path.name for path in to.glob(f"*.{ending}") if path.name not in {*own, SUMMARY, MAPPING})
    if others:
        raise InputError(f"{to} holds {others[0]}, which is no scene of this export; choose an empty folder with --to")
    return list(map_ordered(write, names, workers=workers, label="exporting scenes", count=Count("scene")))


def scene_file(to: Path, name: str, ending: str) -> Path:
    """The file of a scene in an export."""
    variant, slash, inner = name.partition("/")
    called = f"{inner}-{variant}" if slash else name
    return to / (f"sd_{DATASET}_{VERSION}_{called}.pkl" if ending == "pkl" else f"{called}.{ending}")


def _write_scenario(dataset: DataSet, to: Path, name: str) -> tuple[ExportedScene, dict[str, Any]]:
    made = exchanged_of(dataset, name)
    scenario = scenario_of(made)
    path = scene_file(to, name, "pkl")
    write_bytes(path, plain_pickle(scenario))
    metadata = {key: value for key, value in scenario["metadata"].items() if key != OWN}
    return ExportedScene(path, made.scene.name, made.scene.adversaries), metadata


def plain_pickle(value: Any) -> bytes:
    """Pickle plain containers, texts, numbers and arrays: the same bytes for the same values, importing numpy alone."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, _PROTOCOL)
    # Without references: whether two equal texts are one object depends on how they came into memory.
    pickler.fast = True
    pickler.dump(_plain(value))
    return stream.getvalue()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, tuple):
        return tuple(_plain(item) for item in value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return np.ascontiguousarray(value)
    return value
