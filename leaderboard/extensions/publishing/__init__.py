"""Check of a site or a leaderboard before publishing: private content, other hosts (docs/extensions/publishing.md)."""
