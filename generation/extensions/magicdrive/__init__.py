"""Photorealistic video of scenes by MagicDriveDiT, in plain PyTorch."""
