"""Settings of a build."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from benchmark.errors import InputError
from benchmark.machine.workers import Executor, LocalProcesses
from benchmark.machine.workspace import find_timings_folder
from benchmark.records.run_schema import MOST_ADVERSARIES
from generation.labels.manoeuvres import Manoeuvre
from generation.pipeline.panel import PlannerPanel
from generation.pipeline.surrogate import PlannerUnderTest
from generation.render.contract import Renderer
from generation.search.definition import PackagedPrior, PriorFactory
from generation.search.hyperparameters import HyperParameters
from generation.search.presets import build_default_settings


@dataclass(frozen=True, slots=True)
class BuildSettings:
    """Settings of a build: the scenes, the search and the output.

    Attributes:
        out: Root of the new data set.
        source_split: Split of the source that is used.
        scenes: Names of source scenes to use, ``None`` for all.
        limit: Use only this many source scenes.
        seed: Seed of the choice of vehicles and of the search.
        executor: Where the work is done.
        rendering: Where scenes are rendered, if elsewhere: GPUs are fewer than processors.
        together: Attempts that a worker plans side by side, which pays on an accelerator.
        hyper: Settings of the search.
        prior: Makes the diffusion model.
        adversaries: In each scene.
        surrogate: Keep only scenes in which this planner collides; ``None`` keeps all.
        panel: Rank by the probability that its members touch the adversary, and drop inert scenes; ``None`` ranks by
            challenge.
        further: Settings of further searches with the same vehicles' recordings, whose scenes are kept with the others.
        per_scene: Most adversarial variants kept of one source scene, ``None`` for all.
        variants: Most kept of one source scene, each as unlike the others as can be; ``None`` for all.
        asked: Kinds of manoeuvre that every vehicle is asked for, one attempt each; none leaves it free.
        total: Most adversarial scenes kept, ``None`` for all.
        renderer: Draws the images, ``None`` for a data set without images.
        layout: One root with numbered names, or one root per variant with original names.
        frames: Which frames get images and rows.
        version: Version folder that is written.
        jpeg_quality: 1 to 100.
        lossless: Beside each JPEG file a PNG file of the same name.
        keep_rounds: Whether the rounds of the search are kept for ``sheets --rounds``; of ``adv`` alone.
        freeze: File for the frozen split that others rebuild it from (`generation.splits`); of ``adv`` alone.
        timings: Folder for notes on how long work took, outside of the root; ``<out>.timings`` by default.
        dry_run: Only count the work, and time a little of it (`generation.pipeline.report`).
    """

    out: Path
    source_split: str = "val"
    scenes: tuple[str, ...] | None = None
    limit: int | None = None
    seed: int = 0
    executor: Executor = field(default_factory=LocalProcesses)
    rendering: Executor | None = None
    together: int = 1
    hyper: HyperParameters = field(default_factory=build_default_settings)
    prior: PriorFactory = field(default_factory=PackagedPrior)
    adversaries: int = 1
    surrogate: PlannerUnderTest | None = None
    panel: PlannerPanel | None = None
    further: tuple[HyperParameters, ...] = ()
    per_scene: int | None = None
    variants: int | None = None
    asked: tuple[Manoeuvre, ...] = ()
    total: int | None = None
    renderer: Renderer | None = None
    layout: Literal["suffixed", "per-variant"] = "suffixed"
    frames: Literal["all", "keyframes"] = "all"
    version: str = "v1.0-trainval"
    jpeg_quality: int = 92
    lossless: bool = False
    keep_rounds: bool = False
    freeze: Path | None = None
    timings: Path | None = None
    dry_run: bool = False

    def __post_init__(self) -> None:
        for option, number in (("limit", self.limit), ("adversaries", self.adversaries), ("together", self.together)):
            if number is not None and number < 1:
                raise InputError(f"--{option} must be at least 1, got {number}")
        if self.adversaries > MOST_ADVERSARIES:
            raise InputError(f"--adversaries must be at most {MOST_ADVERSARIES:,}; no scene has so many vehicles")

    @property
    def where_rendered(self) -> Executor:
        """Executor of the rendering."""
        return self.rendering or self.executor

    @property
    def timing(self) -> Path:
        """Folder of notes on how long work took; no result depends on them, and no two builds have the same."""
        return self.timings or find_timings_folder(self.out)
