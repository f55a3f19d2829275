"""Search by effect: retimed paths, faults of behaviour, conflicts, and a panel that chooses scenes."""
