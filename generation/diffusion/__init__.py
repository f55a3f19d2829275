"""The trajectory diffusion model: how a vehicle could plausibly move (paper, Diffusion Trajectory Generator)."""
