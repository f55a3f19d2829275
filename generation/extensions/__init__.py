"""Extensions of the search for adversaries: each a folder that can be taken away."""
