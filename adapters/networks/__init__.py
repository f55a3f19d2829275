"""Networks of the native planners in plain PyTorch, forward only."""
