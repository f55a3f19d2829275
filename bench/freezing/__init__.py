"""The table of what is frozen, how a tree runs it, and what of its outputs is compared."""
