"""The CPU renderer: six calibrated views of a scene as a driver would recognise it."""

from generation.render.schematic.renderer import SchematicRenderer
from generation.render.schematic.styles import FIRST, SECOND

__all__ = ["FIRST", "SECOND", "SchematicRenderer"]
