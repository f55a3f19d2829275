"""Planners of other packages, each in a subprocess: if it crashes or hangs, the run continues (docs/planners.md)."""
