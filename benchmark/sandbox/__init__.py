"""Planners of other packages, each in a process of its own: whatever it does, the run goes on (docs/planners.md)."""
