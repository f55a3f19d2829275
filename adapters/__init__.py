"""Planners under test: observation in, three-second plan out."""
