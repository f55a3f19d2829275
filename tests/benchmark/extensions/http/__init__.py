"""Tests of what goes over HTTP: codec, client and server, apart and as a pair."""
