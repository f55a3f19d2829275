"""Physics, scoring and denoiser against golden numbers: a broken library or accelerator shows before results do."""
