"""Options of native networks to behave as in the published runs of their repositories; all are off by default.

* ``memory``: SparseDrive and DiffusionDrive remember beyond a change of scene.
* ``can-once``: UniAD is told where it stands on the map in the first key frame of a run alone; into each later scene
  its motion is measured from where the scene before ended, and its tracks go on being numbered.
* ``can-after``: UniAD and VAD read the CAN message after the sample, not the one before it.

The first two make plans depend on which scenes came before (`benchmark.planning.ContinuousPlanner`).
"""

from collections.abc import Collection, Sequence
from typing import Final

from benchmark.errors import InputError, did_you_mean

MEMORY: Final = "memory"
CAN_ONCE: Final = "can-once"
CAN_AFTER: Final = "can-after"
ALL: Final = "all"
"""All options that a model has."""
OPTIONS: Final = (MEMORY, CAN_ONCE, CAN_AFTER)
CROSS_SCENES: Final = frozenset({MEMORY, CAN_ONCE})
"""With these a split is one unit of work."""


def select_options(name: str, known: Collection[str], asked: Sequence[str]) -> tuple[str, ...]:
    """Options of a model among those asked for, in the order of `OPTIONS`; others are an `InputError`."""
    for option in asked:
        if option not in (*OPTIONS, ALL):
            raise InputError(
                f"unknown option {option!r} of --as-published; {did_you_mean(option, (*OPTIONS, ALL))}"
                f"use {', '.join(OPTIONS)} or {ALL}"
            )
        if option not in known and not (option == ALL and known):
            has = f"it has {', '.join(sorted(known))}" if known else "it has no published run to follow"
            raise InputError(f"{name} does not support --as-published {option}: {has}; leave it out")
    return tuple(option for option in OPTIONS if option in known and (option in asked or ALL in asked))
