"""Weights of networks: published files, users' files and packaged ones, read without running anything in them."""
