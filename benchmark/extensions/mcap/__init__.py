"""Scenes as MCAP files for Foxglove and Lichtblick (docs/extensions/mcap.md)."""
