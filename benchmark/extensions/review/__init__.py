"""Looking at scenes by hand: a local page that shows them one after the other and records verdicts beside the split."""
