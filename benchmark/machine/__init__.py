"""The machine that commands run on: workers, files, devices, folders, and whether it computes correctly."""
