"""AlpaSim's scene score of stored drives, under the rules of July and of September 2026."""
