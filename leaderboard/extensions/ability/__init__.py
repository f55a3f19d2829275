"""Abilities of planners and difficulties of scenes by item response theory (docs/extensions/ability.md)."""
