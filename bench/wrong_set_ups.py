"""Wrong set-ups of a data set or a planner, as they happen to people who run official weights for the first time."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from benchmark.datasets.roots import DataSet
from benchmark.machine.storage import content_key, content_seed
from benchmark.planning import CameraView, Observation, Planner
from benchmark.truth import SampleTruth

OTHER_SIZE = 0.8
"""Of the size that the intrinsics are really for."""
OTHER_WEIGHTS = 0.05
"""Noise on weights, of the deviation of each tensor: another state of training."""
_LEFT_FOR_RIGHT = {"CAM_FRONT_LEFT": "CAM_FRONT_RIGHT", "CAM_BACK_LEFT": "CAM_BACK_RIGHT"}


@dataclass(frozen=True)
class SetUp:
    """One way to set things up.

    Attributes:
        name: In words.
        seen: What a planner is shown in place of an observation.
        shuffled: Whether the frames of a scene come in another order.
        changed: Changes the planner's network.
        plain: Whether the options of the published run are left out.
    """

    name: str
    seen: Callable[[Observation], Observation] = lambda observation: observation
    shuffled: bool = False
    changed: Callable[[Any], None] | None = None
    plain: bool = False


def cameras_exchanged(observation: Observation) -> Observation:
    """Left and right images have changed places, their calibration has not."""
    pairs = {**_LEFT_FOR_RIGHT, **{right: left for left, right in _LEFT_FOR_RIGHT.items()}}
    views = observation.views
    found = {
        name: replace(view, load=views[pairs.get(name, name)].load, path=views[pairs.get(name, name)].path)
        for name, view in views.items()
    }
    return replace(observation, views=found)


def without_can_bus(observation: Observation) -> Observation:
    """The CAN bus expansion was not unpacked."""
    return replace(observation, ego=replace(observation.ego, can_motion=None, can_motion_after=None))


def calibration_of_another_size(observation: Observation) -> Observation:
    """Images were made smaller and their intrinsics were not, or the other way round."""

    def resized(view: CameraView) -> CameraView:
        scale = np.diag([OTHER_SIZE, OTHER_SIZE, 1.0])
        return replace(view, camera=replace(view.camera, intrinsic=scale @ view.camera.intrinsic))

    return replace(observation, views={name: resized(view) for name, view in observation.views.items()})


def with_other_weights(network: torch.nn.Module) -> None:
    """Another state of training: noise on every weight."""
    generator = torch.Generator().manual_seed(content_seed("other weights"))
    with torch.no_grad():
        for weight in network.parameters():
            if weight.is_floating_point() and weight.numel() > 1:
                noise = torch.randn(weight.shape, generator=generator, dtype=weight.dtype)
                weight.add_(OTHER_WEIGHTS * weight.std() * noise)


RIGHT = SetUp("right")
WRONG = (
    SetUp("left and right cameras exchanged", cameras_exchanged),
    SetUp("CAN bus missing", without_can_bus),
    SetUp("calibration of another image size (0.8)", calibration_of_another_size),
    SetUp("frames of a scene out of order", shuffled=True),
    SetUp("other weights (5 % noise)", changed=with_other_weights),
)
PLAIN = SetUp("as eval does by default", plain=True)


class DataSetUp:
    """Some scenes of a data set in a set-up; everything but observations, and the order of truths, is the data set's.

    Args:
        data: The data set.
        scenes: Scenes that count as the split.
        set_up: The set-up.
    """

    def __init__(self, data: DataSet, scenes: Sequence[str], set_up: SetUp) -> None:
        self._data, self._scenes, self._set_up = data, tuple(scenes), set_up
        self.root, self.version, self.name = data.root, data.version, data.name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._data, name)

    def scene_names(self, split: str | None = None) -> tuple[str, ...]:
        """The scenes."""
        return self._scenes

    def fingerprint(self) -> str:
        """Of the data set and the set-up, so that no plans of another one are taken for these."""
        return content_key(self._data.fingerprint(), self._scenes, self._set_up.name)

    def observations(self, name: str) -> Iterator[Observation]:
        """Observations as they are shown."""
        for seen in self._in_order(name, list(self._data.observations(name))):
            yield self._set_up.seen(seen)

    def truth(self, name: str) -> tuple[SampleTruth, ...]:
        """Truths in the order of the observations."""
        return tuple(self._in_order(name, list(self._data.truth(name))))

    def _in_order(self, name: str, samples: list[Any]) -> list[Any]:
        if not self._set_up.shuffled:
            return samples
        order = np.random.default_rng(content_seed("frame order", name)).permutation(len(samples))
        return [samples[index] for index in order]


def changed_planner(planner: Planner, set_up: SetUp) -> Planner:
    """The planner with its network changed as the set-up says; it is changed itself."""
    if set_up.changed is not None:
        set_up.changed(vars(planner)["_network"])
    return planner
