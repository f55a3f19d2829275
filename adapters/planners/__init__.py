"""Planners without images: constant velocity, ego status, IDM, and the recorded ego."""
