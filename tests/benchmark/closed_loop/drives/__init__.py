"""Tests of drives: what is seen, what is asked, what comes of it."""
