"""Extensions of the benchmark: each a folder that can be taken away."""
