"""Comparisons with golden numbers: checks, golden files, and networks filled with synthetic weights."""
