"""Check of a site or a leaderboard before publishing: private content, and whether it works on other hosts.

The checks: docs/extensions/publishing.md.
"""
