"""VAD, the vectorised planner, in plain PyTorch."""
