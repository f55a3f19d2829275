"""Tracks of an ego that a reference driver drove, and of those who answered it, which replace recorded ones."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from benchmark.geometry import Floats
from benchmark.scene import Scene


@dataclass(frozen=True, slots=True)
class DrivenTracks:
    """(T, 3) rear-axle poses of the ego; of others, by identifier, first frame and (F, 3) poses of the box centre."""

    ego: Floats
    others: Mapping[str, tuple[int, Floats]] = field(default_factory=dict)

    def put_into(self, scene: Scene) -> Scene:
        """A scene with these tracks; an adversary's is put into it afterwards."""
        for name, (first, track) in self.others.items():
            scene = scene.with_track(scene.agents.ids.index(name), slice(first, first + len(track)), track)
        return scene.with_ego(self.ego)
