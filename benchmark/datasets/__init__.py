"""Data sets on disk and how to read them."""
