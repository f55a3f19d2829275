"""Submissions: whether records of strangers are fit for a leaderboard (docs/extensions/submissions.md)."""
