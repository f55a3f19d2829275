"""Labels of an adversary's manoeuvre and place, in the frame of the ego's path."""
