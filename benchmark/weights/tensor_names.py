"""Names of tensors in foreign checkpoints: wrappers before them taken off, averaged copies told from what they are of.

Averaged weights (EMA) are taken wherever a file has them. OpenMMLab swaps both copies on saving: plain names have the
average, and mmcv's buffers ``ema_backbone_conv1_weight`` the weights of the last step.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from benchmark.report.words import pluralise

_WRAPPERS: Final = ("module.", "model.", "_orig_mod.")
"""Put before all names by data-parallel training, Lightning and `torch.compile`."""
_AVERAGES: Final = ("ema_model.", "model_ema.", "ema.")
"""Before the names of an averaged copy that is a module beside the network."""
_COUNTERS: Final = frozenset({"n_averaged", "steps", "step", "initted", "updates", "num_updates", "decay"})
"""Of averages, beside their tensors."""


@dataclass(frozen=True, slots=True)
class ChosenTensors:
    """Tensors that are taken of a file: their names there by names without wrappers, and a note on averaged copies."""

    names: Mapping[str, str]
    note: str = ""


def choose_tensors(stored: Collection[str]) -> ChosenTensors:
    """The tensors that a network needs of those in a state dict: the averaged ones where there are two copies."""
    names = _unwrap({name: name for name in stored})
    for average in _AVERAGES:
        copy = _unwrap({name: place for name, place in names.items() if name.startswith(average)}, average)
        others = _unwrap({name: place for name, place in names.items() if not name.startswith(average)})
        if copy and copy.keys() >= others.keys() - _COUNTERS:
            left = f"; {pluralise(len(others), 'tensor')} of the last step are left out" if others else ""
            return ChosenTensors(copy, f"averaged weights ({average}*){left}")
    buffers = {f"ema_{name.replace('.', '_')}" for name in names} & names.keys()
    if not buffers:
        return ChosenTensors(names)
    return ChosenTensors(
        {name: place for name, place in names.items() if name not in buffers},
        "averaged weights (in mmcv's files the plain names); "
        f"{pluralise(len(buffers), 'tensor')} ema_* of the last step are left out",
    )


def _unwrap(names: Mapping[str, str], *wrappers: str) -> dict[str, str]:
    """Places by name without what stands before all names, however often; as they are where two would become one."""
    wrappers = (*wrappers, *_WRAPPERS)
    short = dict(names)
    while wrapper := next((one for one in wrappers if _stands_before_all(one, short)), ""):
        short = {name.removeprefix(wrapper): place for name, place in short.items() if name not in _COUNTERS}
    inner = {name.replace("._orig_mod.", ".").removeprefix("_orig_mod."): place for name, place in short.items()}
    return inner if len(inner) == len(short) else short


def _stands_before_all(wrapper: str, names: Collection[str]) -> bool:
    tensors = [name for name in names if name not in _COUNTERS]
    return bool(tensors) and all(name.startswith(wrapper) for name in tensors)
