"""Recordings of other cars: which camera is which view, what labels mean (docs/extensions/own_recordings.md)."""
