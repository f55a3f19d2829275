"""Whether plans can be in the unit, frame, origin and time that they are read in, wherever they come from."""
