"""Tests of whether plans can be what they are read as."""
