"""Extensions of the leaderboard: each a folder that can be taken away."""
