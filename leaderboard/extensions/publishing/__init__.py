"""Whether a site or a leaderboard may leave the house, and whether it works elsewhere.

What is looked for: docs/extensions/publishing.md.
"""
