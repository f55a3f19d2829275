"""The page of a leaderboard: which sections there are, and the files of each."""
