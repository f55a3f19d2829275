"""Scenes as pictures and films: from above with what planners planned, and through six cameras."""
