"""Builds the data: adversarial scenes, renderers, the nuScenes writer, the embedded town."""
