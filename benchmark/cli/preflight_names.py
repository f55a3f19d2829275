"""Options that name something: planners, devices, packages, settings of the search."""

import importlib.util
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from benchmark import api
from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from benchmark.sandbox.limits import Supervision

_DEVICE: Final = re.compile(r"auto|cpu|cuda(:\d+)?")
_PRECISIONS: Final = ("float32", "bfloat16")


def require_models(
    names: Sequence[str],
    checkpoint: Path | None = None,
    *,
    data: str,
    device: str | None = None,
    precision: str | None = None,
) -> None:
    """Refuse planners that there are not, that have no weights, or that cannot run so.

    Args:
        names: As ``--model`` takes them.
        checkpoint: Their weights, if any were named.
        data: What ``--data`` names.
        device: Where a network runs.
        precision: Of a network.

    Raises:
        InputError: If one is unknown, weights are absent, or there is no such device or precision.
    """
    from adapters.models import MODELS

    for name in names:
        runs = api.model_that_runs(name, checkpoint, data=data)
        # What devices and precisions a stranger's planner has is for the stranger to say.
        if runs not in MODELS or MODELS[runs].network is None:
            continue
        if device is not None:
            require_devices(device)
        if precision is not None and precision not in _PRECISIONS:
            raise InputError(f"there is no precision {precision!r}; use {' or '.join(_PRECISIONS)}")


def require_published_runs(
    names: Sequence[str], checkpoint: Path | None, as_published: Sequence[str], *, data: str
) -> bool:
    """Refuse to do as published what a planner's published runs do not do.

    Args:
        names: As ``--model`` takes them.
        checkpoint: Their weights, if any were named.
        as_published: As ``--as-published`` takes it.
        data: What ``--data`` names.

    Returns:
        Whether any of them then remembers across scenes.

    Raises:
        InputError: If a planner does nothing of the kind.
    """
    from adapters.as_published import CROSS_SCENES, options_of
    from adapters.models import MODELS

    if as_published and not names:
        raise InputError("--as-published says how networks run that --model names; leave it out")
    done: set[str] = set()
    for name in names if as_published else ():
        runs = api.model_that_runs(name, checkpoint, data=data)
        network = MODELS[runs].network if runs in MODELS else None
        done |= set(options_of(runs, {} if network is None else network.as_published, as_published))
    return not CROSS_SCENES.isdisjoint(done)


def supervision_of(names: Sequence[str], sample_limit: float | None, memory_limit: float | None) -> "Supervision":
    """The limits of planners of other packages.

    Args:
        names: As ``--model`` takes them.
        sample_limit: As ``--sample-limit`` takes it.
        memory_limit: As ``--memory-limit`` takes it.

    Returns:
        The limits; of no effect where all planners are of this package.

    Raises:
        InputError: If one is no such number, or there is nobody whom it is for.
    """
    from adapters.registry import is_foreign
    from benchmark.sandbox.limits import Supervision

    given = {"--sample-limit": sample_limit, "--memory-limit": memory_limit}
    said = next((option for option, value in given.items() if value is not None), None)
    if said is not None and not any(is_foreign(name) for name in names):
        raise InputError(
            f"{said} is of planners of other packages, which run in a process of their own (docs/planners.md); leave "
            "it out"
        )
    return Supervision.of(sample_limit, memory_limit)


def planners_shown(names: Sequence[str], records: Sequence[Path], everywhere: Path) -> list[str]:
    """Planners as records name them: a full model that ran as its miniature, or a short name, is that which ran.

    Args:
        names: Planner names as ``--model`` takes them, or as tables show them.
        records: Folders of the run records that will be shown.
        everywhere: Folder of all run records, to say what there is instead.

    Returns:
        The names that the records have; a name stays as it is where they have none of it.

    Raises:
        InputError: If neither a planner nor a record has such a name, or there are no records at all.
    """
    from adapters.checkpoints.stand_in import miniature_of
    from adapters.models import MODELS
    from benchmark.records.inventory import recorded, said_of

    found = recorded(records)
    ran, shown = {each.planner for each in found}, []
    for name in names:
        own = MODELS[name].name if name in MODELS else name
        small = miniature_of(own)
        if name not in ran and own not in ran and small in ran:
            api.say_once(
                f"there are no records of {own}: {small}, which ran in its place, is shown (docs/miniatures.md)"
            )
        known = {*ran, *MODELS}
        # Tables may show a planner with what tells its versions apart: "vad-base (seed 1)".
        if name.partition(" (")[0] not in known and ":" not in name:
            raise InputError(f"no planner is called {name!r}; {did_you_mean(name, known)}{said_of(found)}")
        shown.append(next((each for each in (name, own, small) if each is not None and each in ran), name))
    if names and not found:
        raise InputError(
            f"there are no run records at {', '.join(map(str, records))}; {said_of(recorded([everywhere]))}; name "
            "these with --data and --split, or run challenger-bench eval first"
        )
    return shown


def require_device(name: str) -> None:
    """Refuse what names no device; whether this machine has it is only known to torch, which is slow to import."""
    if not _DEVICE.fullmatch(name):
        raise InputError(f"there is no device {name!r}; use cpu, cuda, cuda:1 or auto")


def require_devices(names: str) -> None:
    """`require_device` of each of several, which commas separate."""
    from benchmark.machine.several_devices import device_names

    for name in device_names(names):
        require_device(name)


def require_published(name: str, *, files: bool = False) -> None:
    """Raise `InputError` for what names no model with published weights and, with ``files``, no file of theirs."""
    from adapters.models import published_model
    from benchmark.weights.catalogue import FOLDERS, checkpoint_of

    if name not in {entry.name for entry in FOLDERS}:
        checkpoint_of(name) if files else published_model(name)


def require_normalisation(name: str | None) -> None:
    """Raise `InputError` for what names no pixel values that networks want; ``None`` is none, which is fine."""
    from adapters.camera_inputs import normalisation_of

    if name is not None:
        normalisation_of(name)


def require_clustered(model: str) -> None:
    """Raise `InputError` for what names no model that starts from anchors."""
    from adapters.models import published_models

    known = [name for name, each in published_models().items() if each.net.clustered]
    if model not in known:
        raise InputError(
            f"{model!r} is no model with anchors; {did_you_mean(model, known)}those are {', '.join(known)}"
        )


def require_trainable(model: str) -> None:
    """Raise `InputError` for what names no network that is trained here."""
    from adapters.models import miniature

    if model != "image-encoder":
        miniature(model)


def require_package(module: str, sentence: str) -> None:
    """Raise `InputError` with a sentence where an optional package is not installed; nothing is imported."""
    if importlib.util.find_spec(module) is None:
        raise InputError(sentence)


def require_categories(named: str | None) -> None:
    """Refuse a map of categories that there is not; raises `InputError`."""
    from benchmark.datasets.categories import read_categories

    if named is not None:
        read_categories(named)
