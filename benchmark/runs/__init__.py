"""Runs of planners: what their plans depend on."""
