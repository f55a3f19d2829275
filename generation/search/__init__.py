"""The search for adversaries (paper, Algorithm 1): candidates, refinement, scores, verification, attempts."""
