"""How good a trajectory model is, measured for its model card."""
