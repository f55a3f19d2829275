"""Closed loop: the plan is driven and the world answers (docs/closed-loop.md)."""
