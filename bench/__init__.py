"""Measurements of the project itself: speed, memory, model cards, equality of two trees."""
