"""AlpaSim's scene score in the tables of drives."""
