"""Frozen splits: adversarial splits as a few kilobytes a scene, rebuilt from the recordings without a search."""
