"""Options that several commands share, and how their texts are read."""

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from benchmark import api
from benchmark.cli.settings import Option
from benchmark.constants import LARGEST_SEED
from benchmark.errors import InputError

if TYPE_CHECKING:
    from benchmark.machine.workers import Executor as Place
    from benchmark.runs.units import Shard as ShardOfScenes


Models = Annotated[
    tuple[str, ...], Option("Planner, package.module:Class, http:// or grpc://HOST:PORT; repeatable.", "Planner")
]
Checkpoint = Annotated[Path | None, Option("Weights of the model.", "Planner")]
NetworkDevices = Annotated[
    str | None,
    Option(
        "Device, or several: cpu, cuda:1, cuda:0,cuda:1; by default the first GPU.",
        "Planner",
        separated=True,
    ),
]
NetworkDevice = Annotated[
    str | None, Option("Where a network runs: cpu, cuda, cuda:1; the first GPU if there is one.", "Planner")
]
Precision = Annotated[str | None, Option("Of a network: float32 or bfloat16.", "Planner")]
Root = Annotated[str, Option("mini, demo or the root of a data set, generated ones included.", "Input", names="")]
Data = Annotated[str, Option("mini, demo or the root of a nuScenes-format data set.", "Input")]
Tables = Annotated[str | None, Option("Version folder below the root, if there are several.", "Input")]
Categories = Annotated[
    str | None,
    Option(
        "What categories that are not nuScenes' mean: short, lyft, t4, argoverse2 or a JSON file (docs/data.md).",
        "Input",
    ),
]
DrivingSide = Annotated[
    Literal["left", "right"] | None,
    Option("Side that traffic keeps to; by default found from lanes and place (docs/fault.md).", "Input"),
]
Cameras = Annotated[
    str | None,
    Option(
        "Which camera is which view: nuscenes, nuplan, argoverse2, waymo, front, directions or a JSON file "
        "(docs/extensions/own_recordings.md).",
        "Input",
    ),
]
Out = Annotated[Path, Option("Folder for all output.", "Output")]
Split = Annotated[str, Option("val, val-r, adv, or a split of the data set's own.", "Input")]
Splits = Annotated[
    tuple[str, ...], Option("val, val-r, adv, or a split of the data set's own; may be repeated.", "Input")
]
Scenes = Annotated[str | None, Option("Only these scenes, separated by commas.", "Input", separated=True)]
Normalisation = Annotated[
    str | None, Option("Pixel values that the weights want, if the file is wrong on it.", "Planner")
]
Records = Annotated[
    tuple[Path, ...] | None,
    Option("Folder of run records, if not <out>/runs; may be repeated, and name single runs.", "Input"),
]
Shard = Annotated[
    str | None, Option("Do every n-th scene alone: 3/40 is the third of 40.", "Execution", metavar="<k/n>")
]
Limit = Annotated[int | None, Option("Only the first so many scenes.", "Input", min=1)]
Seed = Annotated[int, Option("Same seed, same bytes, on one kind of processor.", "Execution", min=0, max=LARGEST_SEED)]
Workers = Annotated[int, Option("Processes; 0 takes all processors.", "Execution")]
Json = Annotated[bool, Option("Machine-readable output on stdout, nothing else there.", "Output", names="--json")]
Wide = Annotated[bool, Option("Print every column of the tables.", "Output")]
Verbose = Annotated[
    bool, Option("Print all notes: what columns mean, steps that protocols mask.", "Output", short="-v")
]
By = Annotated[
    tuple[Literal["place", "light", "manoeuvre", "speed", "command"], ...] | None,
    Option("The same numbers also by one of these; repeatable.", "Output"),
]
DryRun = Annotated[bool, Option("Say what would be done, and do nothing.", "Output")]
AsPublished = Annotated[
    tuple[Literal["memory", "can-once", "can-after", "all"], ...] | None,
    Option("What networks do as in the published runs of their repositories (docs/models.md); repeatable.", "Planner"),
]
Preset = Annotated[
    Literal["default", "effect", "near", "paper", "reference"],
    Option(
        "default, effect (a panel chooses), near (no threats), paper (text), reference (code); --dry-run lists "
        "departures.",
        "Search",
    ),
]
Set = Annotated[
    tuple[str, ...] | None,
    Option("Change a hyper-parameter, NAME=VALUE; repeatable (docs/generation.md).", "Search", names="--set"),
]
Denoiser = Annotated[Path | None, Option("Weights of another trajectory model, such as ig360_adv.ckpt.", "Search")]
Device = Annotated[str, Option("Where the trajectory model runs: cpu, cuda, cuda:1.", "Planner")]
Devices = Annotated[
    str, Option("Where the trajectory model runs: cpu, cuda, cuda:1, or several for a process each.", "Execution")
]
Together = Annotated[int, Option("Attempts planned side by side in a process; pays on a GPU.", "Execution", min=1)]
Samples = Annotated[
    Literal["fresh", "reference", "stored"] | None,
    Option(
        "First candidates: fresh from noise in a few calls, by the reference's 100 steps, or stored ones.", "Search"
    ),
]
Dropout = Annotated[bool, Option("Sample with dropout on, as the reference code does by an omission.", "Search")]
Calls = Annotated[
    int | None, Option("Network calls of a mutation at most; the reference has one a noise level.", "Search", min=1)
]
Executor = Annotated[
    Literal["local", "ray"], Option("This machine's processes, or an existing Ray cluster.", "Execution")
]
Address = Annotated[str | None, Option("HOST:PORT of the Ray cluster, or auto.", "Execution")]
ImageFormat = Annotated[
    Literal["torch", "png", "auto", "jpeg"] | None,
    Option(
        "How a model is sent pictures: at http:// torch (NeuroNCAP's), png, or auto, which tries both; at grpc:// jpeg "
        "or png.",
        "Planner",
    ),
]
PlanFrame = Annotated[
    Literal["lidar", "ego"] | None,
    Option(
        "Frame of the plans of a file or of a model at http://: lidar (x right, y forward) or ego (x forward, y left), "
        "whatever the file or the protocol says.",
        "Planner",
    ),
]
SampleLimit = Annotated[
    float | None, Option("Seconds that a planner of another package may take for a plan; 120 unless told.", "Planner")
]
MemoryLimit = Annotated[
    float | None, Option("GiB that a planner of another package may hold; no limit unless told.", "Planner")
]
WeightsFolder = Annotated[Path | None, Option("Folder that holds published weights, if not the cache.", "Output")]
Size = Annotated[str, Option("Image size, WIDTHxHEIGHT.", "Output")]
DrawnSize = Annotated[
    Literal["224x400", "424x800"], Option("magicdrive: what the network draws, HEIGHTxWIDTH.", "Output")
]
WrittenSize = Annotated[
    Literal["model", "1600x900"],
    Option("magicdrive: what is written, the network's size or the camera's.", "Output", names="--image-size"),
]
RequestedConditions = Annotated[
    Literal["recorded", "daytime", "rainy", "night"],
    Option("magicdrive: light and weather, if not those of the recording.", "Output"),
]
RenderDevice = Annotated[str, Option("magicdrive: auto, cpu, cuda (all GPUs, a worker on each), cuda:1.", "Output")]
Speed = Annotated[
    float | None, Option("magicdrive: the device's speed for estimates, if not to be measured.", "Output", min=1e-3)
]
FilmLayout = Annotated[
    Literal["both", "cameras", "birdseye"], Option("What a frame shows.", "Output", names="--layout")
]
FilmFormat = Annotated[
    Literal["webm", "png", "webp"],
    Option("A film, numbered frames, or an animated picture for pages.", "Output", names="--format"),
]
QuickRenderer = Annotated[Literal["schematic", "none"], Option("Who draws the images.", "Output")]
Lossless = Annotated[bool, Option("Keep a PNG file beside each JPEG file.", "Output")]
Frames = Annotated[Literal["all", "keyframes"], Option("Images at all 12 Hz frames or at 2 Hz keyframes.", "Output")]


def parse_image_size(text: str) -> tuple[int, int]:
    """Width and height of ``WIDTHxHEIGHT``; raises `InputError` for anything else."""
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()) or not (32 <= int(width) <= 8192 and 32 <= int(height) <= 8192):
        raise InputError(f"--size {text!r} is not WIDTHxHEIGHT in pixels; use for example 448x256 (32 to 8192 each)")
    return int(width), int(height)


def parse_name_list(text: str | None) -> tuple[str, ...] | None:
    """Names between commas, or ``None`` if nothing was given."""
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def parse_shard(text: str | None) -> "ShardOfScenes | None":
    """The part of ``--shard``, if one is given; slow to import."""
    if text is None:
        return None
    from benchmark.runs.units import Shard as ShardOfScenes

    return ShardOfScenes.named(text)


def make_executor(name: str, address: str | None, workers: int) -> "Place":
    """Where work is done; raises `InputError` if the options contradict each other."""
    if name == "local":
        from benchmark.machine.workers import LocalProcesses

        if address is not None:
            raise InputError("--address needs --executor ray; add it or leave --address out")
        return LocalProcesses(api.worker_count(workers))
    from benchmark.machine.extension import require_package
    from benchmark.machine.ray_cluster import NOT_INSTALLED, RayCluster

    require_package("ray", NOT_INSTALLED)
    return RayCluster(address or "auto")


def list_hyper_parameters() -> frozenset[str]:
    """Names of the settings of the search."""
    from generation.search.hyperparameters import HyperParameters

    return frozenset(field.name for field in fields(HyperParameters))
