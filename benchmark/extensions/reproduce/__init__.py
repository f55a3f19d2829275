"""Official weights beside their published numbers."""
