"""Training of the trajectory model: recordings as windows, the loop, measurements and the model card."""
