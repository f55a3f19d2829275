"""A run: plans of every scene, kept and judged, and records judged anew."""
