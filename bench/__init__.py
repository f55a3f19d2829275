"""Measurements of the project itself: speed, memory, equality of two trees."""
