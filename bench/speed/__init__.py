"""How fast things are, beside a slow reference in the same run."""
