"""Options that several commands share, and how their texts are read."""

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmark.errors import InputError


class Frames(StrEnum):
    """Which frames get images."""

    ALL = "all"
    KEYFRAMES = "keyframes"


class Layout(StrEnum):
    """How several variants of one scene lie on disk."""

    SUFFIXED = "suffixed"
    PER_VARIANT = "per-variant"


class RendererName(StrEnum):
    """Who draws the images."""

    SCHEMATIC = "schematic"
    NONE = "none"


class Verifiable(StrEnum):
    """What has golden numbers."""

    PHYSICS = "physics"
    SCORING = "scoring"
    DENOISER = "denoiser"


DataOption = Annotated[str, typer.Option("--data", help="mini (embedded) or the root of a nuScenes-format data set.")]
TablesOption = Annotated[
    str | None, typer.Option("--tables", help="Version folder below the root, if there are several.")
]
OutOption = Annotated[Path, typer.Option("--out", help="Folder for everything that commands make.")]
SplitOption = Annotated[str, typer.Option("--split", help="val, val-r, adv, or a split of the data set's own.")]
ScenesOption = Annotated[str | None, typer.Option("--scenes", help="Only these scenes, separated by commas.")]
LimitOption = Annotated[int | None, typer.Option("--limit", min=1, help="Only the first so many scenes.")]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed; the same seed gives the same bytes.")]
WorkersOption = Annotated[int, typer.Option("--workers", help="Processes; 0 takes all processors.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Machine-readable output on stdout, nothing else there.")]
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")]
SizeOption = Annotated[str, typer.Option("--size", help="Image size, WIDTHxHEIGHT.")]
FramesOption = Annotated[Frames, typer.Option("--frames", help="Images at all 12 Hz frames or at 2 Hz keyframes.")]


def image_size(text: str) -> tuple[int, int]:
    """Width and height of ``WIDTHxHEIGHT``; raises `InputError` for anything else."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()) or not (32 <= int(width) <= 8192 and 32 <= int(height) <= 8192):
        raise InputError(f"--size {text!r} is not WIDTHxHEIGHT in pixels, for example 448x256 (32 to 8192 each)")
    return int(width), int(height)


def name_list(text: str | None) -> tuple[str, ...] | None:
    """Names between commas, or ``None`` if nothing was given."""
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def worker_count(count: int) -> int:
    """Number of processes: 0 is all processors; raises `InputError` if negative."""
    from benchmark.workers import default_workers

    if count < 0:
        raise InputError(f"--workers must be 0 (all processors) or more, got {count}")
    return count or default_workers()


def print_json(value: Any) -> None:
    """Machine-readable output: JSON and nothing else on stdout."""
    typer.echo(json.dumps(value, indent=1, sort_keys=True, allow_nan=False))
