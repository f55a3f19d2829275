"""The commands that are killed, each on what the ones before it made of one small data set."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from adapters.extensions.training.ego_status import HELD_OUT_SOURCES, TRAINING_SOURCES
from bench.attacking.children import run_command
from benchmark.errors import InputError
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.render.schematic import SchematicRenderer
from tests.hand_made import Car, scene_on_straight_road

_SCENES: Final = ((Car(62.0, 194.75, 9.0), Car(95.0, 198.25, 8.0)), (Car(45.0, 201.75, 8.0), Car(90.0, 198.25, 7.0)))
_SMALL: Final = ("--candidates", "16", "--rounds", "1", "--vehicles", "2", "--seed", "3", "--preset", "near")
_DRAWN: Final = ("--size", "64x40", "--frames", "keyframes")
_FILMED: Final = ("--width", "320", "--fps", "2", "--until", "4", "--model", "constant-velocity")


@dataclass(frozen=True, slots=True)
class Killed:
    """A command that is killed.

    Attributes:
        name: As the table shows it.
        arguments: Of the command line; ``{data}`` is the recorded data set, ``{tracks}`` a folder of track files beside
            it, ``{out}`` the folder to write to.
        after: Commands whose results it needs, by name.
        parallel: Whether it has ``--workers``.
        on_ray: Whether it has ``--executor``.
    """

    name: str
    arguments: tuple[str, ...]
    after: tuple[str, ...] = ()
    parallel: bool = True
    on_ray: bool = False


_OF_DATA: Final = ("--data", "{data}", "--out", "{out}")
_MADE: Final = ("generate", "eval", "sheets")
COMMANDS: Final = (
    Killed("generate", ("generate", *_OF_DATA, *_SMALL, *_DRAWN, "--keep-rounds"), on_ray=True),
    Killed(
        "generate --surrogate",
        ("generate", *_OF_DATA, *_SMALL, "--renderer", "none", "--surrogate", "bench.killing.weaving:Weaving"),
    ),
    Killed("generate --split val-r", ("generate", *_OF_DATA, *_DRAWN, "--split", "val-r")),
    Killed(
        "eval", ("eval", *_OF_DATA, "--split", "adv", "--model", "constant-velocity", "--model", "idm"), ("generate",)
    ),
    Killed("drive", ("drive", *_OF_DATA, "--split", "val", "--model", "stop", "--agents", "idm"), on_ray=True),
    Killed("sheets", ("sheets", *_OF_DATA, "--split", "adv", "--rounds", "--cell-width", "64"), ("generate",)),
    Killed("film", ("film", *_OF_DATA, "--to", "{out}/films", "--format", "webp", *_FILMED), _MADE, parallel=False),
    Killed(
        "film --format png",
        ("film", *_OF_DATA, "--to", "{out}/films", "--format", "png", *_FILMED),
        _MADE,
        parallel=False,
    ),
    Killed("leaderboard", ("leaderboard", "--out", "{out}"), (*_MADE, "drive"), parallel=False),
    Killed(
        "train denoiser",
        ("train", "denoiser", "--tracks", "{data}", "--out", "{out}/denoiser.safetensors", "--steps", "6"),
        parallel=False,
    ),
    Killed(
        "train ego-status",
        ("train", "ego-status", "--tracks", "{tracks}", "--out", "{out}/ego-status.safetensors"),
        parallel=False,
    ),
    Killed(
        "train planner",
        ("train", "planner", "--model", "image-encoder", "--data", "{data}", "--split", "val", "--steps", "4")
        + ("--device", "cpu", "--out", "{out}/encoder.safetensors"),
    ),
)


def command_named(name: str) -> Killed:
    """The command of a name."""
    return next(each for each in COMMANDS if each.name == name)


def write_recorded(root: Path) -> Path:
    """The recorded data set: two short scenes with pictures, and track files beside it; made once."""
    if (root / "complete").is_file():
        return root / "road"
    shutil.rmtree(root, ignore_errors=True)
    renderer = SchematicRenderer(64, 36)
    plan = DataSetPlan(root=root / "road", split="val", version="v1.0-mini", renderer=renderer, frames="keyframes")
    scenes = [scene_on_straight_road(cars, seconds=10.0, name=f"scene-{n}") for n, cars in enumerate(_SCENES, 9901)]
    keys = [write_scene(plan, each, name=each.name, source_scene=each.name, report={}) for each in scenes]
    finish_data_set(plan, keys)
    _write_tracks(root / "tracks")
    (root / "complete").touch()
    return root / "road"


def _write_tracks(folder: Path) -> None:
    """A car that drives straight on and one that turns, in every track file of ``train ego-status``."""
    folder.mkdir()
    seconds = np.arange(120) / 10.0
    heading = np.concatenate([np.zeros_like(seconds), 0.05 * seconds])
    x, y = np.concatenate([8.0 * seconds, 120.0 * np.sin(0.05 * seconds)]), 0.0 * heading
    y[len(seconds) :] = 120.0 * (1.0 - np.cos(0.05 * seconds))
    for source in (*TRAINING_SOURCES, *HELD_OUT_SOURCES):
        np.savez(
            folder / f"{source}.npz",
            ptr=[0, len(seconds), 2 * len(seconds)],
            x=x,
            y=y,
            heading=heading,
            length=[4.6, 4.6],
            cls=["car", "car"],
            hz=10.0,
            source=source,
            licence="none",
        )


def write_needed(command: Killed, data: Path, folder: Path, case: Path) -> Path:
    """What a command finds in ``--out``: the undisturbed results of the ones before it; made once.

    Args:
        command: The command.
        data: The recorded data set.
        folder: Holds what is made.
        case: Where commands run: records and sheets are made at one place, whichever command needs them.

    Returns:
        A folder to copy.

    Raises:
        InputError: If a command fails.
    """
    needed = folder / ("-".join(command.after) or "nothing")
    if needed.is_dir():
        return needed
    shutil.rmtree(case, ignore_errors=True)
    out = case / "out"
    out.mkdir(parents=True)
    for name in command.after:
        ended = run_command(words(command_named(name), data, out, 1), case, case / "cache")
        if ended.code:
            raise InputError(f"{name} failed undisturbed: {ended.err.strip()[-400:]}; mend it first")
    shutil.copytree(out, needed)
    return needed


def words(command: Killed, data: Path, out: Path, workers: int, *, ray: str | None = None) -> list[str]:
    """The command line of a command; ``ray`` is the address of a cluster."""
    given = [each.format(data=data, tracks=data.parent / "tracks", out=out) for each in command.arguments]
    if ray is not None:
        return [*given, "--executor", "ray", "--address", ray]
    return [*given, "--workers", str(workers)] if command.parallel else given
