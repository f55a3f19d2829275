"""What docs/stability.md promises, and what holds it."""
