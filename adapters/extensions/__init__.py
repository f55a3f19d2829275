"""Extensions that need networks or planners: each a folder that can be taken away."""
