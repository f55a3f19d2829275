"""Where a command finds its data set and puts what it makes (docs/decisions/0002)."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from benchmark.errors import InputError
from benchmark.machine.user_cache import cache_root as cache_root
from benchmark.records.seed_splits import RECORDED_EGO, parse_ego, parse_seed, strip_ego
from benchmark.report.words import format_options

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

GENERATED_SPLITS = ("val-r", "adv")
"""Splits that `generate` builds, beside the source's own."""
# Beside these: one split for each seed (`benchmark.records.seed_splits`).
EMBEDDED = "mini"
DEMONSTRATED = "demo"
"""The small town, and the ``adv`` made from it, that ``challenger-bench demo`` leaves below ``--out``."""
EMBEDDED_VERSION: Final = 2
"""Version of the town that ``mini`` names; `generation.sources.embedded` has all versions."""
_EMBEDDED_NAME: Final = re.compile(rf"{EMBEDDED}(?:@(?P<version>[1-9]\d{{0,3}}))?")

TIMINGS_FOLDER = "timings"


def is_embedded_name(data: str) -> bool:
    """Whether a value of ``--data`` is no root: ``mini``, ``mini@1``, ``demo``; a folder so called is ``./demo``."""
    return data == DEMONSTRATED or read_embedded_version(data) is not None


def read_embedded_version(data: str) -> int | None:
    """Version of the embedded town that ``mini`` or ``mini@1`` names, if there is one; ``None`` of other data sets."""
    found = _EMBEDDED_NAME.fullmatch(data)
    return None if found is None else int(found["version"] or EMBEDDED_VERSION)


def strip_version(data: str) -> str:
    """Name of a data set without the version of a town: what is made from ``mini@1`` says ``mini``, as it did."""
    return data if read_embedded_version(data) is None else EMBEDDED


def find_timings_folder(made: Path) -> Path:
    """Folder of notes on how long it took to make something that lies in no ``--out`` folder: beside it."""
    return made.with_name(f"{made.name}.{TIMINGS_FOLDER}")


def format_generate_options(split: str) -> str:
    """Options of ``generate`` that make a split; of a split of one seed, with another seed beside it."""
    seed, ego = parse_seed(split), parse_ego(split)
    if ego != RECORDED_EGO:
        return f"--split {strip_ego(split)} --ego {ego}"
    return f"--split {split}" if seed is None else f"--seeds {seed},{seed + 1}"


def weights_root() -> Path:
    """Folder of weights that were imported or fetched."""
    return cache_root() / "weights"


@dataclass(frozen=True, slots=True)
class Workspace:
    """One ``--out`` folder.

    Attributes:
        out: The folder.
    """

    out: Path

    def split_root(self, data_name: str, split: str) -> Path:
        """Root of a generated split."""
        return self.out / "data" / data_name / split

    def demonstrated(self, split: str) -> Path:
        """Root of a split that ``challenger-bench demo`` made; raises `InputError` where it has not run."""
        root = self.split_root(DEMONSTRATED, split)
        if not is_finished(root):
            raise InputError(
                f"--data demo is the output of the demo, missing at {root}; run: challenger-bench demo"
                f"{format_options(out=self.out)}"
            )
        return root

    def run_root(self) -> Path:
        """Folder of all run records."""
        return self.out / "runs"

    def drive_root(self) -> Path:
        """Folder of all records of drives."""
        return self.out / "drives"

    def quality_root(self) -> Path:
        """Folder of all records of video quality."""
        return self.out / "quality"

    def sheet_root(self) -> Path:
        """Folder of all scene sheets."""
        return self.out / "sheets"

    def ablation_root(self) -> Path:
        """Folder of all ablation studies."""
        return self.out / "ablation"

    def challenge_root(self) -> Path:
        """Verdicts on entries of challenges and their scores, a folder for each entry."""
        return self.out / "challenge"

    def timings_of(self, made: Path) -> Path:
        """Folder of notes on how long it took to make something: outside of it, whose bytes are not the clock's.

        It is below ``<out>/timings``; `find_timings_folder` of all that is not below the folder.
        """
        is_inside = made.is_relative_to(self.out)
        return self.out / TIMINGS_FOLDER / made.relative_to(self.out) if is_inside else find_timings_folder(made)

    def rendering_root(self) -> Path:
        """Folder of what takes long to draw, kept between the stages of photorealistic rendering."""
        return self.out / "rendering"

    def open_split(self, source: "DataSet", split: str, *, build: Callable[[], Path] | None = None) -> "DataSet":
        """The data set that holds a split of a source.

        Args:
            source: The data set that ``--data`` names.
            split: ``val``, ``val-r``, ``adv`` or any split the source itself has.
            build: Called when a generated split is not finished and there is another way to it (the embedded data
                set); gives the root of a finished one.

        Returns:
            The source itself, or the generated root that was made from it.

        Raises:
            InputError: If the split has not been generated, or was made from another version of the source.
        """
        from benchmark.datasets.roots import open_data

        root = self.split_root(source.name, split)
        if not is_generated(split) or (not root.exists() and _has_split(source, split)):
            return source
        if not is_finished(root) and build is not None:
            root = build()
        if not is_finished(root):
            town = None if source.name == EMBEDDED else source.name
            data = source.root if read_embedded_version(source.name) is None else town
            raise InputError(
                f"split {split!r} of {source.name} is missing at {root}; build it with: challenger-bench generate"
                f"{format_options(data=data)} {format_generate_options(split)}{format_options(out=self.out)}"
            )
        generated = open_data(root, name=source.name)
        made_from = (generated.provenance() or {}).get("source") or {}
        if made_from.get("fingerprint") != source.fingerprint():
            raise InputError(
                f"{root} was generated from another version of {source.name} (its fingerprint differs"
                f"{hint_at_earlier_town(source.name)}); "
                f"run challenger-bench generate{format_options(data=source.root)} {format_generate_options(split)} "
                "again or choose another --out"
            )
        return generated


def hint_at_earlier_town(data: str) -> str:
    """What to say where ``mini`` is not what it was: how its last version is opened; nothing of other data sets."""
    is_newer = data == EMBEDDED and EMBEDDED_VERSION > 1
    return f"; before, {EMBEDDED} was what --data {EMBEDDED}@{EMBEDDED_VERSION - 1} is now" if is_newer else ""


def is_generated(split: str) -> bool:
    """Whether `generate` builds splits of a name."""
    return strip_ego(split) in GENERATED_SPLITS or parse_seed(split) is not None


def is_finished(root: Path) -> bool:
    """Whether a root made by the writer is complete: its provenance file is written last."""
    return any(root.glob("*/challenger.json")) or any(root.glob("v*/*/challenger.json"))


def _has_split(source: "DataSet", split: str) -> bool:
    from benchmark.datasets.split_names import NoSuchSplitError

    try:
        return bool(source.scene_names(split))
    except NoSuchSplitError:
        return False
