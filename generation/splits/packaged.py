"""Frozen splits by name: packaged ones, any file, and files of one search with several seeds."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from benchmark.machine.workspace import read_embedded_version, strip_version
from benchmark.records.seed_splits import format_seed_split, parse_seed
from generation.sources.embedded import find_version, format_town
from generation.splits.format import FrozenScene, FrozenSplit, SceneChoice, SearchMetadata, read_frozen

_FOLDER: Final = Path(__file__).parent
_NUMBERED: Final = re.compile(r"(?P<data>.+)-(?P<split>[a-z]+)-(?P<number>[1-9]\d*)")


@dataclass(frozen=True, slots=True)
class NamedSplit:
    """A frozen split and its name: the file without ``.json``. ``path`` is the file, if one was named."""

    name: str
    frozen: FrozenSplit
    path: Path | None = field(default=None, compare=False)

    def chosen(self, scenes: Sequence[str] | None, limit: int | None) -> list[tuple[FrozenScene, int]]:
        """Some scenes, of the first ``limit`` recordings, each with its number among the variants of its recording.

        ``scenes`` are names in the split, or of recorded scenes for all that are made of them; ``None`` for all.
        """
        variant_counts: dict[str, int] = {}
        numbered = []
        for frozen in self.frozen.scenes:
            numbered.append((frozen, variant_counts.get(frozen.source, 0)))
            variant_counts[frozen.source] = numbered[-1][1] + 1
        numbered_names = {frozen.numbered: frozen.name for frozen in self.frozen.scenes if frozen.numbered is not None}
        wanted = {numbered_names.get(name, name) for name in (variant_counts if scenes is None else scenes)}
        unknown = sorted(wanted - set(variant_counts) - {frozen.name for frozen in self.frozen.scenes})
        if unknown:
            raise InputError(
                f"frozen split {self.name} has no scene made from {', '.join(unknown)}; it has scenes made from "
                f"{', '.join(sorted(variant_counts)[:8])}{' ...' if len(variant_counts) > 8 else ''}"
            )
        matching = [scene for scene in numbered if scene[0].source in wanted or scene[0].name in wanted]
        recorded = set(sorted({frozen.source for frozen, _ in matching})[:limit])
        return [scene for scene in matching if scene[0].source in recorded]


def list_packaged_splits(data: str = "", split: str = "adv") -> tuple[str, ...]:
    """Names of the frozen splits that come with the package, the newest last.

    Args:
        data: Only those of this data set.
        split: Only those of this split.

    Returns:
        Names such as ``mini-adv-1``: data set, split and a number that grows.
    """
    numbered = []
    for path in _FOLDER.glob("*.json"):
        named = _NUMBERED.fullmatch(path.stem)
        if named and named["split"] == split and data in ("", named["data"]):
            numbered.append((named["data"], int(named["number"]), path.stem))
    return tuple(name for _, _, name in sorted(numbered))


def read_newest_split(data: str, split: str = "adv") -> NamedSplit:
    """The newest frozen split of a data set that comes with the package, of those with recorded egos and no panel.

    Of ``mini@1`` that of the first town.
    """
    version = read_embedded_version(data)
    for name in reversed(list_packaged_splits(strip_version(data), split)):
        named = read_frozen_split(name)
        if (
            named.frozen.chosen.panel is None
            and named.frozen.search.ego is None
            and (version is None or _find_town(named) in (None, version))
        ):
            return named
    raise InputError(f"no frozen split {split} of {data} is packaged; run challenger-bench generate")


def read_frozen_split(file: str | Path) -> NamedSplit:
    """A frozen split by the name of a packaged one, or from a file.

    Args:
        file: Name or path.

    Returns:
        It.

    Raises:
        InputError: If there is no such split or the file is not one.
    """
    if str(file) in list_packaged_splits():
        return NamedSplit(str(file), read_frozen(_FOLDER / f"{file}.json"))
    path = Path(file)
    if not path.exists():
        raise InputError(
            f"there is no file {path} and no frozen split of that name; packaged ones are "
            f"{', '.join(list_packaged_splits()) or 'none'}"
        )
    return NamedSplit(path.stem, read_frozen(path), path)


def require_town(named: NamedSplit, data: str) -> None:
    """Refuse a frozen split of another version of the embedded town than ``--data`` names."""
    made_from, given = _find_town(named), read_embedded_version(data)
    if made_from is not None and given is not None and made_from != given:
        right = format_town(made_from)
        raise InputError(
            f"frozen split {named.name} was made from another embedded town than {data}; give --data {right}"
        )


def _find_town(named: NamedSplit) -> int | None:
    recordings = named.frozen.recordings
    is_packaged = named.path is None and named.name in list_packaged_splits()
    return find_version(recordings.name, recordings.fingerprint, packaged=is_packaged)


def compute_search_hash(search: SearchMetadata, chosen: SceneChoice, adversaries: int) -> str:
    """Hash, 64 hexadecimal digits, of what decided a split, without its recordings, its seed and its outcome."""
    searched = [search.algorithm, search.hyper, search.prior, *([] if search.solvable is None else [search.solvable])]
    chose: list[Any] = [chosen.scenes, chosen.per_scene, chosen.total, chosen.surrogate, adversaries]
    younger = {"variants": chosen.variants, "asked": chosen.asked, "panel": chosen.panel}
    # Searches without them keep the hash of earlier versions.
    chose += [{name: value} for name, value in younger.items() if value]
    return content_key("search", searched, *chose)


def format_seed_path(path: Path, seed: int) -> Path:
    """The frozen split of one seed, beside those of the others: ``town-seed-2.json`` of ``town.json``."""
    return path.with_name(f"{path.stem}-seed-{seed}{path.suffix or '.json'}")


def read_frozen_of_seed(path: Path, seed: int) -> NamedSplit:
    """Read the frozen split of one seed, searched with it; ``path`` is what the files of all seeds are called after."""
    own = format_seed_path(path, seed)
    if not own.exists():
        raise InputError(
            f"there is no file {own}, the frozen split of seed {seed}; give --from the file name given to --freeze, "
            "without the seed"
        )
    named_split = read_frozen_split(own)
    require_seed(format_seed_split(seed), named_split.frozen.search.seed, str(own))
    return named_split


def require_seed(split: str, seed: int, what: str) -> None:
    """Raise `InputError` if a split that is called after a seed comes from another one."""
    named = parse_seed(split)
    if named is not None and named != seed:
        raise InputError(
            f"{what} was searched with seed {seed}, so it is not {split}; build it as {format_seed_split(seed)}"
        )


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds between commas, such as ``0,1,2``, in their order: at least two, none of them twice."""
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"0|[1-9]\d{0,17}", word) for word in words) or len(set(words)) < max(len(words), 2):
        raise InputError(f"--seeds {text[:80]!r} must be two or more different whole numbers, such as 0,1,2")
    return tuple(map(int, words))
