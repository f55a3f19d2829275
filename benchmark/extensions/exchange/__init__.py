"""Scenes for the code of others: ScenarioNet both ways, OpenSCENARIO, and nuScenes under its own validation names."""
