"""A drive: what a planner sees of a driven world, what it answers, and what came of it, whatever engine drives."""
