"""The CPU renderer: six calibrated views of a scene as a driver would recognise it."""

from generation.render.schematic.renderer import SchematicRenderer

__all__ = ["SchematicRenderer"]
