"""What waits for a GPU, in pieces of under ten minutes: `bench/gpu.py` runs them."""
