"""Whether a site or a leaderboard may leave the house, and whether it works elsewhere (docs/site.md)."""
