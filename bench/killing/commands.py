"""The commands that are killed (``commands.toml``), each on what the ones before it made of one small data set."""

import shutil
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from adapters.extensions.training.ego_status import HELD_OUT_SOURCES, TRAINING_SOURCES
from bench.attacking.children import run_command
from bench.attacking.table import arguments
from benchmark.errors import InputError
from generation.render.schematic import SchematicRenderer
from tests.generation.extensions.denoiser_training.test_tracks import drive, write_tracks
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import Car, scene_on_straight_road

_SCENES: Final = ((Car(62.0, 194.75, 9.0), Car(95.0, 198.25, 8.0)), (Car(45.0, 201.75, 8.0), Car(90.0, 198.25, 7.0)))
_TABLE: Final = tomllib.loads((Path(__file__).parent / "commands.toml").read_text())


@dataclass(frozen=True, slots=True)
class KilledCommand:
    """A command that is killed.

    Attributes:
        name: As the table shows it.
        arguments: Of the command line; ``{data}`` is the recorded data set, ``{tracks}`` a folder of track files beside
            it, ``{out}`` the folder to write to, ``{url}`` the address of a model server.
        after: Commands whose results it needs, by name.
        parallel: Whether it has ``--workers``.
        on_ray: Whether it has ``--executor``.
    """

    name: str
    arguments: tuple[str, ...]
    after: Sequence[str] = ()
    parallel: bool = True
    on_ray: bool = False

    @property
    def served(self) -> bool:
        """Whether it asks a model server; the server is killed, not the command."""
        return any("{url}" in argument for argument in self.arguments)


COMMANDS: Final = {
    name: KilledCommand(name, arguments(said.pop("line"), _TABLE["words"]), **said)
    for name, said in _TABLE["command"].items()
}
"""By name, in the order in which they begin."""


def write_recorded(root: Path) -> Path:
    """The recorded data set: two short scenes with pictures, and track files beside it; made once."""
    if (root / "complete").is_file():
        return root / "road"
    shutil.rmtree(root, ignore_errors=True)
    scenes = [scene_on_straight_road(cars, seconds=10.0, name=f"scene-{n}") for n, cars in enumerate(_SCENES, 9901)]
    write_root(root / "road", scenes, version="v1.0-mini", renderer=SchematicRenderer(64, 36), frames="keyframes")
    # A car that drives straight on and one that turns, in every file that `train ego-status` wants.
    tracks = [drive(np.full(120, 8.0)), drive(np.full(120, 6.0), 0.05)]
    (root / "tracks").mkdir()
    for source in (*TRAINING_SOURCES, *HELD_OUT_SOURCES):
        write_tracks(root / "tracks" / f"{source}.npz", tracks, source=np.array(source))
    (root / "complete").touch()
    return root / "road"


def write_needed(command: KilledCommand, data: Path, folder: Path, case: Path) -> Path:
    """What a command finds in ``--out``: what the ones before it leave undisturbed, all at one place; made once."""
    needed = folder / ("-".join(command.after) or "nothing")
    if needed.is_dir():
        return needed
    shutil.rmtree(case, ignore_errors=True)
    out = case / "out"
    out.mkdir(parents=True)
    for name in command.after:
        ended = run_command(words(COMMANDS[name], data, out, 1), case)
        if ended.code:
            raise InputError(f"{name} failed undisturbed: {ended.err.strip()[-400:]}; mend it first")
    shutil.copytree(out, needed)
    return needed


def words(command: KilledCommand, data: Path, out: Path, workers: int, *, ray: str = "", url: str = "") -> list[str]:
    """The command line of a command; ``ray`` is the address of a cluster, ``url`` that of a model server."""
    places = {"data": data, "tracks": data.parent / "tracks", "out": out, "url": url}
    line = [argument.format(**places) for argument in command.arguments]
    if ray:
        return [*line, "--executor", "ray", "--address", ray]
    return [*line, "--workers", str(workers)] if command.parallel else line
