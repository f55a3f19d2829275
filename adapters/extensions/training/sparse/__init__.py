"""How the miniatures of SparseDrive and DiffusionDrive learn."""
