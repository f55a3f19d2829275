"""Where the recorded car is at a sample, how fast it is, and in what light: what samples are sorted by."""
