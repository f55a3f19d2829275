"""What is cheap to check, checked before anything that costs: nothing is built, and nothing left behind."""
