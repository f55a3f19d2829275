"""Recordings that a build uses, and what decides its search."""

from collections.abc import Sequence

from benchmark.datasets.annotated_objects import require_annotated
from benchmark.datasets.roots import DataSet
from benchmark.datasets.scene_names import resolve_names
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.workspace import is_generated
from benchmark.records.seed_splits import format_ego_split, parse_ego, strip_ego
from benchmark.report.words import pluralise
from generation.nuscenes_writer.plan import STATE_FOLDER
from generation.pipeline.settings import BuildSettings
from generation.search.definition import Search
from generation.splits.building import require_not_frozen
from generation.splits.format import require_freezable
from generation.splits.packaged import require_seed


def require_buildable(source: DataSet, split: str, settings: BuildSettings) -> tuple[str, ...]:
    """Refuse what cannot be built, as `build_split` does; gives the recorded scenes that are used."""
    require_generated(split)
    require_ego(split, settings)
    require_seed(split, settings.seed, f"--seed {settings.seed}")
    require_not_frozen(settings.out)
    if settings.freeze is not None:
        require_freezable(split, settings.freeze)
    return list_source_scenes(source, settings)


def build_search(source: DataSet, names: Sequence[str], settings: BuildSettings) -> Search:
    """Everything that decides the attempts of a build; every scene needs a map."""
    without_map = [name for name in names if not source.has_map(name)]
    if without_map:
        raise InputError(
            f"{source.root} has no map expansion for {without_map[0]} ({len(without_map)} of "
            f"{pluralise(len(names), 'scene')}), and "
            "the search needs the road; put the map expansion's JSON files into maps/expansion"
        )
    return Search(
        fingerprint=source.fingerprint(),
        hyper=settings.hyper,
        seed=settings.seed,
        prior=settings.prior,
        prior_fingerprint=settings.prior().fingerprint,
        state=settings.out / STATE_FOLDER,
        timings=settings.timing,
        asked=settings.asked,
        further=settings.further,
    )


def require_generated(split: str) -> None:
    """Raise `InputError` for a split that cannot be generated."""
    if not is_generated(split):
        raise InputError(f"cannot generate split {split!r}; choose val-r, adv, or adv-seed-N with seed N")


def require_ego(split: str, settings: BuildSettings) -> None:
    """Raise `InputError` for a split that is called after another ego than the one that drives."""
    if parse_ego(split) != settings.hyper.ego.value:
        name = format_ego_split(strip_ego(split), settings.hyper.ego.value)
        raise InputError(f"the ego is {settings.hyper.ego.value}, so the split is not {split}; build it as {name}")


def list_source_scenes(source: DataSet, settings: BuildSettings) -> tuple[str, ...]:
    """Names of the recorded scenes that a build uses, in order; scenes without annotations are skipped."""
    names = _list_requested_scenes(source, settings)
    require_annotated(source, settings.source_split, names)
    skipped = set(list_unlabelled_scenes(source, settings))
    return tuple(name for name in names if name not in skipped)


def _list_requested_scenes(source: DataSet, settings: BuildSettings) -> tuple[str, ...]:
    if settings.scenes is None:
        names = source.scene_names(settings.source_split)
    else:
        known, asked = set(source.scene_names(None)), resolve_names(source.provenance(), settings.scenes)
        unknown = [name for name in asked if name not in known]
        if unknown:
            raise InputError(
                f"{source.name} has no scene {', '.join(unknown)}; {did_you_mean(unknown[0], known)}it has "
                f"{', '.join(sorted(known)[:8])} ..."
            )
        names = tuple(dict.fromkeys(asked))
    if not names:
        raise InputError(f"{source.name} has no scenes in split {settings.source_split}")
    return names[: settings.limit]


def list_unlabelled_scenes(source: DataSet, settings: BuildSettings) -> tuple[str, ...]:
    """Scenes that a build asks for and skips: without annotations there is no traffic to change or to draw."""
    names = _list_requested_scenes(source, settings)
    counts = source.annotation_counts(names)
    return tuple(name for name in names if not counts[name].annotations)
