"""Who is to blame for a contact: on a map, a lateral one is the ego's fault in several lanes or off the road.

``docs/severity.md``, "A pair at one instant". The surfaces are those of ``nuscenes-pdm`` (`benchmark.pdm.layers`).
"""

from functools import cached_property

from benchmark.geometry import Floats
from benchmark.interactions.contacts import ContactKind, at_fault
from benchmark.pdm.layers import road_of, route_of
from benchmark.pdm.road import Road
from benchmark.scene import Scene


class Blame:
    """Blame for contacts of one scene; the map is only looked at for lateral ones."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.has_map = not scene.road_map.drivable_area.is_empty

    def at_fault(self, kind: ContactKind, ego: Floats) -> bool | None:
        """Whether the ego is to blame for a first contact; ``None`` for a lateral one without a map."""
        if kind is not ContactKind.LATERAL:
            return at_fault(kind, unsure=False)
        return at_fault(kind, bool(self._road.unsure(ego[None])[0])) if self.has_map else None

    @cached_property
    def _road(self) -> Road:
        return road_of(self._scene.road_map, route_of(self._scene.ego.pose))
