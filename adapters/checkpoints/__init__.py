"""Official weights: what there is, how a foreign file is read without trusting it, and what is kept of it."""
