"""An entry as its organiser sees it: who is changed was found, and nothing that it says of itself is read."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from benchmark.datasets.annotated_objects import AnnotationCount
from benchmark.datasets.categories import CategoryNames
from benchmark.datasets.roots import DataSet
from benchmark.datasets.scene_facts import build_scene_facts
from benchmark.fairness.scene_assessment import AdversaryProvenance, assess_scene
from benchmark.planning import CameraView, Observation
from benchmark.records.challenge import EntryVerdict, SceneVerdict
from benchmark.records.review import SplitReview
from benchmark.records.run_schema import SceneFacts
from benchmark.records.scene_assessment import SceneAssessment
from benchmark.road_map import Handedness
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

SPLIT: Final = "entry"
"""Split name of the accepted scenes of an entry."""


@dataclass(slots=True)
class CheckedEntry:
    """Accepted scenes of an entry (`benchmark.datasets.roots.DataSet`) with this program's own assessments.

    `root` is a folder of the organiser's: nothing that lies beside the entry's tables is looked for.
    """

    data: DataSet
    name: str
    root: Path
    version: str
    verdicts: Mapping[str, SceneVerdict]
    judgements: Mapping[str, tuple[SceneAssessment, ...]]

    @classmethod
    def of(cls, data: DataSet, name: str, root: Path, verdict: EntryVerdict) -> Self:
        """The accepted scenes of an entry, judged."""
        accepted = {scene.scene: scene for scene in verdict.scenes if scene.accepted}
        unjudged = cls(data, name, root, data.version, accepted, {})
        judged = {scene: assess_scene(unjudged.scene(scene), unjudged.tracks(scene)) for scene in accepted}
        return replace(unjudged, judgements=judged)

    def tracks(self, name: str) -> AdversaryProvenance:
        """Findings on how the changed vehicles of a scene were made."""
        seconds = self.data.scene(name).seconds
        starts = {
            vehicle.instance: int(np.argmin(np.abs(seconds - vehicle.from_s)))
            for vehicle in self.verdicts[name].changed
        }
        return AdversaryProvenance(generated=False, launches=starts)

    @property
    def categories(self) -> CategoryNames:
        """Those of the entry's data."""
        return self.data.categories

    def with_categories(self, categories: CategoryNames) -> Self:
        """The same entry with other names of categories replaced."""
        return replace(self, data=self.data.with_categories(categories))

    @property
    def driving_side(self) -> Handedness | None:
        """That of the entry's data."""
        return self.data.driving_side

    def with_driving_side(self, side: Handedness | None) -> Self:
        """The same entry where traffic keeps to a side."""
        return replace(self, data=self.data.with_driving_side(side))

    def annotation_counts(self, names: Sequence[str]) -> dict[str, AnnotationCount]:
        """How many annotations scenes have, by name."""
        return self.data.annotation_counts(names)

    def splits(self) -> dict[str, tuple[str, ...]]:
        """The accepted scenes."""
        return {SPLIT: self.scene_names()}

    def split_names(self) -> tuple[str, ...]:
        """The only split."""
        return (SPLIT,)

    def scene_names(self, split: str | None = None) -> tuple[str, ...]:
        """Sorted names of the accepted scenes."""
        return tuple(sorted(self.verdicts))

    def review(self, split: str | None = None) -> SplitReview:
        """All scenes wait: entries are not inspected."""
        return SplitReview(waiting=self.scene_names())

    def scene(self, name: str) -> Scene:
        """One scene, with the changed vehicles as adversaries."""
        return replace(
            self.data.scene(name), adversaries=tuple(vehicle.instance for vehicle in self.verdicts[name].changed)
        )

    def observations(self, name: str) -> Iterator[Observation]:
        """One observation a sample, in time order."""
        return self.data.observations(name)

    def videos(self, name: str, *, sweeps: bool) -> dict[str, tuple[CameraView, ...]]:
        """Camera images by camera name, in time order."""
        return self.data.videos(name, sweeps=sweeps)

    def truth(self, name: str) -> tuple[SampleTruth, ...]:
        """One truth a sample, in time order; the changed vehicles are the adversaries, named by the entry or not."""
        changed = frozenset(vehicle.instance for vehicle in self.verdicts[name].changed)
        return tuple(_mark_adversaries(truth, changed) for truth in self.data.truth(name))

    def keyframe_rows(self, name: str) -> dict[str, str]:
        """Sample tokens of a scene by the tokens of their keyframe rows."""
        return self.data.keyframe_rows(name)

    def has_map(self, name: str) -> bool:
        """Whether the scene's location has a vector map."""
        return self.data.has_map(name)

    def has_lidar(self, name: str) -> bool:
        """Whether the tables hold the mounting of the scene's lidar."""
        return self.data.has_lidar(name)

    def fingerprint(self) -> str:
        """Content hash of the entry."""
        return self.data.fingerprint()

    def provenance(self) -> dict[str, Any] | None:
        """Findings by scene: recording, changed vehicles and the times from which they are changed."""
        scenes = {}
        for name, verdict in self.verdicts.items():
            starts = [{"launch_frame": start} for start in self.tracks(name).launches.values()]
            scenes[name] = {
                "source_scene": verdict.recording,
                "adversaries": [vehicle.instance for vehicle in verdict.changed],
                "report": starts[0] if len(starts) == 1 else {"adversaries": starts},
            }
        return {"split": SPLIT, "scenes": scenes}

    def scene_facts(self, names: Sequence[str]) -> dict[str, SceneFacts]:
        """Recordings and judgements of scenes, by name."""
        scenes = {}
        for name in names:
            verdict = self.verdicts[name]
            origin = {
                "source_scene": verdict.recording,
                "adversaries": [vehicle.instance for vehicle in verdict.changed],
            }
            description = self.data.scene(name).description
            scenes[name] = build_scene_facts(name, origin, description, self.judgements.get(name, ()))
        return scenes


def _mark_adversaries(truth: SampleTruth, adversaries: frozenset[str]) -> SampleTruth:
    timed = None if truth.timed is None else replace(truth.timed, adversaries=adversaries)
    return replace(truth, adversaries=adversaries, timed=timed)
