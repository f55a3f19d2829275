"""Where scenes come from: the embedded town, and recordings of other formats."""
