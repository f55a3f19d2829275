"""Options that several commands share, and how their texts are read."""

import json
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmark import api
from benchmark.constants import LARGEST_SEED
from benchmark.errors import InputError

if TYPE_CHECKING:
    from benchmark.machine.workers import Executor


class Frames(StrEnum):
    """Which frames get images."""

    ALL = "all"
    KEYFRAMES = "keyframes"


class SheetPictures(StrEnum):
    """Which frames of a scene sheet get a picture of all cameras."""

    KEYFRAMES = "keyframes"
    ALL = "all"
    NONE = "none"


class Layout(StrEnum):
    """How several variants of one scene lie on disk."""

    SUFFIXED = "suffixed"
    PER_VARIANT = "per-variant"


class RendererName(StrEnum):
    """Who draws the images of a split."""

    SCHEMATIC = "schematic"
    MAGICDRIVE = "magicdrive"
    NONE = "none"


class SliceName(StrEnum):
    """What the samples of tables may be sorted by (`benchmark.metrics.slices.KINDS`)."""

    PLACE = "place"
    LIGHT = "light"
    MANOEUVRE = "manoeuvre"
    SPEED = "speed"
    COMMAND = "command"


class QuickRendererName(StrEnum):
    """Who draws the images of recordings that have none."""

    SCHEMATIC = "schematic"
    NONE = "none"


class DrawnSize(StrEnum):
    """What the photorealistic renderer draws, height and width."""

    SMALL = "224x400"
    LARGE = "424x800"


class WrittenSize(StrEnum):
    """What the photorealistic renderer writes."""

    MODEL = "model"
    CAMERA = "1600x900"


class AskedLook(StrEnum):
    """Light and weather that the photorealistic renderer is asked for."""

    RECORDED = "recorded"
    DAYTIME = "daytime"
    RAINY = "rainy"
    NIGHT = "night"


class AsPublished(StrEnum):
    """What networks do as in the published runs of their repositories."""

    MEMORY = "memory"
    CAN_ONCE = "can-once"
    CAN_AFTER = "can-after"
    ALL = "all"


class Verifiable(StrEnum):
    """What has golden numbers."""

    PHYSICS = "physics"
    SCORING = "scoring"
    DENOISER = "denoiser"
    PROTOCOLS = "protocols"
    PDM = "pdm"
    NEURONCAP = "neuroncap"
    INFOS = "infos"
    RESULTS = "results"
    DRIVERS = "drivers"
    SEVERITY = "severity"
    REALISM = "realism"
    MODEL = "model"


class SampleSource(StrEnum):
    """Where first candidates come from."""

    FRESH = "fresh"
    REFERENCE = "reference"
    STORED = "stored"


class Architecture(StrEnum):
    """Which trajectory network is trained."""

    PACKAGED = "packaged"
    PUBLISHED = "published"


class Preset(StrEnum):
    """Settings of the search to start from."""

    DEFAULT = "default"
    NEAR = "near"
    PAPER = "paper"
    REFERENCE = "reference"


class FilmLayoutName(StrEnum):
    """What a frame of a film shows."""

    BOTH = "both"
    CAMERAS = "cameras"
    BIRDSEYE = "birdseye"


class FilmFormatName(StrEnum):
    """What a film is written as."""

    WEBM = "webm"
    PNG = "png"
    WEBP = "webp"


class ImageFormatName(StrEnum):
    """How pictures are sent to a model behind HTTP."""

    TORCH = "torch"
    PNG = "png"


class FrameName(StrEnum):
    """Frame of plans that others made."""

    LIDAR = "lidar"
    EGO = "ego"


class ExecutorName(StrEnum):
    """Where work is done."""

    LOCAL = "local"
    RAY = "ray"


DataOption = Annotated[
    str,
    typer.Option("--data", help="mini (embedded), demo (what demo made) or the root of a nuScenes-format data set."),
]
TablesOption = Annotated[
    str | None, typer.Option("--tables", help="Version folder below the root, if there are several.")
]
CategoriesOption = Annotated[
    str | None,
    typer.Option(
        "--categories",
        metavar="<str>",
        help="What categories that are not nuScenes' mean: short, lyft, t4, argoverse2 or a JSON file (docs/data.md).",
    ),
]
OutOption = Annotated[Path, typer.Option("--out", help="Folder for everything that commands make.")]
SplitOption = Annotated[str, typer.Option("--split", help="val, val-r, adv, or a split of the data set's own.")]
ScenesOption = Annotated[str | None, typer.Option("--scenes", help="Only these scenes, separated by commas.")]
NormalisationOption = Annotated[
    str | None, typer.Option("--normalisation", help="Pixel values that the weights want, if the file is wrong on it.")
]
RecordsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--records",
        metavar="<path>",
        help="Folder of run records, if not <out>/runs; may be repeated, and name single runs.",
    ),
]
ShardOption = Annotated[
    str | None,
    typer.Option("--shard", metavar="<k/n>", help="Do every n-th scene alone: 3/40 is the third of 40."),
]
LimitOption = Annotated[int | None, typer.Option("--limit", min=1, help="Only the first so many scenes.")]
SeedOption = Annotated[
    int,
    typer.Option("--seed", min=0, max=LARGEST_SEED, help="Seed; on this kind of processor, the same bytes each time."),
]
WorkersOption = Annotated[int, typer.Option("--workers", help="Processes; 0 takes all processors.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Machine-readable output on stdout, nothing else there.")]
WideOption = Annotated[
    bool, typer.Option("--wide", help="Print every column of the tables, however wide the terminal is.")
]
ByOption = Annotated[
    list[SliceName] | None,
    typer.Option("--by", help="Also the same numbers by place, light, manoeuvre, speed or command; may be repeated."),
]
DryRunOption = Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and do nothing.")]
AsPublishedOption = Annotated[
    list[AsPublished] | None,
    typer.Option(
        "--as-published",
        help="What networks do as in the published runs of their repositories (docs/models.md); may be repeated.",
    ),
]
PresetOption = Annotated[
    Preset,
    typer.Option(
        "--preset",
        help="default, near (no threats), paper (text), reference (code); --dry-run lists departures.",
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="<str>", help="Change a hyper-parameter, NAME=VALUE; may be repeated (docs/generation.md)."
    ),
]
DenoiserOption = Annotated[
    Path | None, typer.Option("--denoiser", help="Weights of another trajectory model, such as ig360_adv.ckpt.")
]
DeviceOption = Annotated[str, typer.Option("--device", help="Where the trajectory model runs: cpu, cuda, cuda:1.")]
DevicesOption = Annotated[
    str,
    typer.Option("--device", help="Where the trajectory model runs: cpu, cuda, cuda:1, or several for a process each."),
]
TogetherOption = Annotated[
    int, typer.Option("--together", min=1, help="Attempts planned side by side in a process; pays on a GPU.")
]
SamplesOption = Annotated[
    SampleSource | None,
    typer.Option(
        "--samples",
        help="First candidates: fresh from noise in a few calls, by the reference's 100 steps, or stored ones.",
    ),
]
DropoutOption = Annotated[
    bool, typer.Option("--dropout", help="Sample with dropout on, as the reference code does by an omission.")
]
CallsOption = Annotated[
    int | None,
    typer.Option("--calls", min=1, help="Network calls of a mutation at most; the reference has one a noise level."),
]
ExecutorOption = Annotated[
    ExecutorName, typer.Option("--executor", help="This machine's processes, or an existing Ray cluster.")
]
AddressOption = Annotated[str | None, typer.Option("--address", help="HOST:PORT of the Ray cluster, or auto.")]
ImageFormatOption = Annotated[
    ImageFormatName | None,
    typer.Option("--image-format", help="How a model at http:// is sent pictures: torch (NeuroNCAP's) or png."),
]
PlanFrameOption = Annotated[
    FrameName | None,
    typer.Option(
        "--frame",
        help="Frame of the plans of a file or of a model at http://: lidar (x right, y forward) or ego (x forward, y "
        "left), whatever the file or the protocol says.",
    ),
]
SampleLimitOption = Annotated[
    float | None,
    typer.Option(
        "--sample-limit", help="Seconds that a planner of another package may take for a plan; 120 unless told."
    ),
]
MemoryLimitOption = Annotated[
    float | None,
    typer.Option("--memory-limit", help="GiB that a planner of another package may hold; no limit unless told."),
]
WeightsFolderOption = Annotated[
    Path | None, typer.Option("--weights-folder", help="Folder that holds published weights, if not the cache.")
]
SizeOption = Annotated[str, typer.Option("--size", help="Image size, WIDTHxHEIGHT.")]
DrawnSizeOption = Annotated[
    DrawnSize, typer.Option("--render-size", help="magicdrive: what the network draws, HEIGHTxWIDTH.")
]
WrittenSizeOption = Annotated[
    WrittenSize, typer.Option("--image-size", help="magicdrive: what is written, the network's size or the camera's.")
]
AskedLookOption = Annotated[
    AskedLook, typer.Option("--prompt-look", help="magicdrive: light and weather, if not those of the recording.")
]
RenderDeviceOption = Annotated[
    str, typer.Option("--render-device", help="magicdrive: auto, cpu, cuda (all GPUs, a worker on each), cuda:1.")
]
SpeedOption = Annotated[
    float | None,
    typer.Option("--tflops", min=1e-3, help="magicdrive: the device's speed for estimates, if not to be measured."),
]
FilmLayoutOption = Annotated[FilmLayoutName, typer.Option("--layout", help="What a frame shows.")]
FilmFormatOption = Annotated[
    FilmFormatName, typer.Option("--format", help="A film, numbered frames, or an animated picture for pages.")
]
LosslessOption = Annotated[bool, typer.Option("--lossless", help="Keep a PNG file beside each JPEG file.")]
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


def executor_of(name: ExecutorName, address: str | None, workers: int) -> "Executor":
    """Where work is done; raises `InputError` if the options contradict each other."""
    if name is ExecutorName.LOCAL:
        from benchmark.machine.workers import LocalProcesses

        if address is not None:
            raise InputError("--address belongs to --executor ray; add it or leave the address out")
        return LocalProcesses(api.worker_count(workers))
    from benchmark.cli.preflight_names import require_package
    from benchmark.machine.ray_cluster import NOT_INSTALLED, RayCluster

    require_package("ray", NOT_INSTALLED)
    return RayCluster(address or "auto")


def say_plan(sentences: Sequence[str], *, json_output: bool) -> None:
    """What ``--dry-run`` prints."""
    if json_output:
        print_json({"would": list(sentences)})
    else:
        typer.echo("\n".join(sentences))


def print_json(value: Any) -> None:
    """Machine-readable output: JSON and nothing else on stdout."""
    typer.echo(json.dumps(value, indent=1, sort_keys=True, allow_nan=False))
