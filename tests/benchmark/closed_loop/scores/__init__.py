"""Tests of what is said of drives."""
