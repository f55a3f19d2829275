"""SparseDrive and DiffusionDrive, planners on sparse queries, in plain PyTorch."""
