"""`challenger-bench verify model`: networks under test against golden sets of their official code."""
