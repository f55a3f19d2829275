"""Settings of ``generate``."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.options import list_hyper_parameters
from benchmark.cli.settings import Option

BUILT_IN_RENDERERS: Final = ("schematic", "none")


@dataclass(frozen=True, slots=True, kw_only=True)
class GenerateOptions:
    """Options of ``generate``."""

    EXTENDED: ClassVar = ("renderer",)

    RARE: ClassVar = (
        *("address", "tables", "categories", "cameras", "source_split", "surrogate_checkpoint", "sample_limit"),
        *("memory_limit", "variants", "top", "rounds", "parked", "denoiser", "calls", "dropout", "samples"),
        *("together", "layout", "size", "render_size", "written_size", "prompt_look", "lossless"),
        *("weights_folder", "render_device", "tflops", "seeds", "keep_rounds", "profile"),
    )

    split: shared.Split = "adv"
    from_file: Annotated[
        str | None,
        Option(
            "A frozen split (file or mini-adv-3) or edited ScenarioNet files; no search.",
            "Input",
            names="--from",
        ),
    ] = None
    data: shared.Data = "mini"
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    out: shared.Out = api.OUT
    freeze: Annotated[Path | None, Option("Also write the result as a frozen split to this file.", "Output")] = None
    renderer: Annotated[
        Literal["schematic", "magicdrive", "none"],
        Option("Who draws the images.", "Output", offers=("renderer", BUILT_IN_RENDERERS)),
    ] = "schematic"
    frames: shared.Frames = "all"
    json_output: shared.Json = False
    dry_run: shared.DryRun = False
    verbose: shared.Verbose = False
    adversaries: Annotated[int, Option("Adversaries in each scene.", "Search", min=1)] = 1
    manoeuvres: Annotated[
        tuple[str, ...] | None,
        Option("Steer the search to this kind, e.g. cut-in-left; repeatable.", "Search", names="--manoeuvre"),
    ] = None
    preset: shared.Preset = "default"
    changes: shared.Set = None
    candidates: Annotated[int | None, Option("Candidates per planning step.", "Search", min=4, max=65536)] = None
    vehicles: Annotated[int | None, Option("Vehicles to try per scene, at most.", "Search", min=1)] = None
    per_scene: Annotated[int | None, Option("Keep at most so many variants of a scene.", "Search", min=1)] = None
    surrogate: Annotated[str | None, Option("Keep only scenes in which this planner collides.", "Search")] = None
    ego: Annotated[
        Literal["recorded", "idm", "careful"],
        Option("The ego: as recorded, or a reference driver who answers.", "Search"),
    ] = "recorded"
    keep_unsolvable: Annotated[
        bool,
        Option("Keep scenes that nobody could have avoided (docs/severity.md).", "Search"),
    ] = False
    device: shared.Devices = "cpu"
    workers: shared.Workers = 0
    seed: shared.Seed = 0
    shard: shared.Shard = None
    executor: shared.Executor = "local"
    address: shared.Address = None
    tables: shared.Tables = None
    categories: shared.Categories = None
    cameras: shared.Cameras = None
    source_split: Annotated[str, Option("Split of the data set to start from.", "Input")] = "val"
    surrogate_checkpoint: Annotated[Path | None, Option("Weights of the surrogate.", "Search")] = None
    sample_limit: shared.SampleLimit = None
    memory_limit: shared.MemoryLimit = None
    variants: Annotated[
        int | None, Option("Keep at most so many variants of a scene, those that differ most.", "Search", min=1)
    ] = None
    top: Annotated[int | None, Option("Keep only the so many most challenging scenes.", "Search", min=1)] = None
    rounds: Annotated[int | None, Option("Refinement rounds per planning step.", "Search", min=0)] = None
    parked: Annotated[bool, Option("Also try vehicles that never move.", "Search", names="--parked/--no-parked")] = (
        False
    )
    denoiser: shared.Denoiser = None
    calls: shared.Calls = None
    dropout: shared.Dropout = False
    samples: shared.Samples = None
    together: shared.Together = 1
    layout: Annotated[
        Literal["suffixed", "per-variant"], Option("One root for all scenes, or one root per variant.", "Output")
    ] = "suffixed"
    size: shared.Size = "448x256"
    render_size: shared.DrawnSize = "224x400"
    written_size: shared.WrittenSize = "1600x900"
    prompt_look: shared.RequestedConditions = "recorded"
    lossless: shared.Lossless = False
    weights_folder: shared.WeightsFolder = None
    render_device: shared.RenderDevice = "auto"
    tflops: shared.Speed = None
    seeds: Annotated[
        str | None, Option("Build one split for each seed, adv-seed-0, adv-seed-1, ...: 0,1,2.", "Execution")
    ] = None
    keep_rounds: Annotated[bool, Option("Keep what sheets --rounds shows, less than a megabyte a scene.", "Output")] = (
        False
    )
    profile: Annotated[
        bool, Option("Say where the time went, beside the paper's table.", "Output", names="--profile/--no-profile")
    ] = False

    @staticmethod
    def from_record(members: "Mapping[str, Any]") -> "dict[str, Any] | None":
        """Settings of the search of a built split."""
        from benchmark.cli.record_settings import read_generate_options

        return read_generate_options(members)

    @staticmethod
    def reserved() -> "frozenset[str]":
        """Names that ``--set`` leaves to the search: its hyper-parameters."""
        return list_hyper_parameters()
