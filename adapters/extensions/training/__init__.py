"""How the miniatures of the native models are trained: what is learned from, the losses they share, the loop."""
