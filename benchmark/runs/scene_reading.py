"""Each part of a scene, read once for all planners that run on it."""

from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING

from benchmark.datasets.sample_truth import compute_truth
from benchmark.datasets.truth_facts import compute_truth_facts
from benchmark.metrics.places import SampleContext, read_sample_contexts
from benchmark.pdm.recorded_scene import RecordedScene
from benchmark.planning import Observation
from benchmark.records.run_schema import TruthFacts
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


class SceneReading:
    """One scene of a data set."""

    def __init__(self, data: "DataSet", name: str) -> None:
        self._data, self.name = data, name
        self._observations: tuple[Observation, ...] | None = None
        self._longer: dict[int, tuple[SampleTruth, ...]] = {}

    def scene(self, name: str) -> Scene:
        """The scene, as planners' sources give it."""
        return self._data.scene(name)

    def observations(self, name: str) -> Iterator[Observation]:
        """Observations of a planner, one a sample, in time order."""
        if self._observations is None:
            self._observations = tuple(self._data.observations(name))
        return iter(self._observations)

    @cached_property
    def truth(self) -> tuple[SampleTruth, ...]:
        """Truths, one a sample."""
        return self._data.truth(self.name)

    @cached_property
    def truth_facts(self) -> TruthFacts:
        """Facts of the data set about the scene's truth."""
        return compute_truth_facts(self._data, self.name, self.truth)

    def longer(self, steps: int) -> tuple[SampleTruth, ...]:
        """The same for more steps than protocols need."""
        if steps not in self._longer:
            tokens = [truth.sample_token for truth in self.truth]
            self._longer[steps] = compute_truth(self._data.scene(self.name), tokens, steps)
        return self._longer[steps]

    @cached_property
    def around(self) -> tuple[SampleContext, ...]:
        """Place and speed of the recorded car at each sample."""
        return read_sample_contexts(self._data.scene(self.name))

    @cached_property
    def recording(self) -> Scene | None:
        """The scene, whether it has a map or not."""
        return self._data.scene(self.name)

    @cached_property
    def mapped(self) -> Scene | None:
        """The scene for driving scores; ``None`` where the data set has no map of its place."""
        return self._data.scene(self.name) if self._data.has_map(self.name) else None

    @cached_property
    def recorded(self) -> RecordedScene | None:
        """Recording of the scene to judge driving by, if it has a map."""
        return None if self.mapped is None else RecordedScene(self.mapped)


def collect_truth_facts(data: "DataSet", scenes: Iterable[str]) -> dict[str, TruthFacts]:
    """Facts of a data set about the truth of scenes, by name, for records whose units do not bring them along."""
    return {name: SceneReading(data, name).truth_facts for name in scenes}
