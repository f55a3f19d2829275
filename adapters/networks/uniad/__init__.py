"""UniAD, planning on tracks, map, forecasts and occupancy, in plain PyTorch."""
