"""The table of AlpaSim's challenge in its own files, from its summaries or from drives of ours."""
