"""Scenes in the file formats of other simulators: ScenarioNet both ways, OpenSCENARIO out."""
