"""What an adversary does, in the frame of the ego's path, and where."""
