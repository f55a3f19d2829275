"""Whether plans can be in the unit, frame, origin and time that they are read in; nothing here knows where they come from."""
