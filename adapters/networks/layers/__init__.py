"""Layers that image-to-plan networks share, in plain PyTorch; parameters carry the names of published checkpoints."""
