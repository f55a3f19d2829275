"""Results, read once: runs and drives as rows of tables, and tables as columns over them."""
