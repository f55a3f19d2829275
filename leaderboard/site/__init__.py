"""The leaderboard as a static site: one folder that opens from disk and makes no network requests."""
