"""NeuroNCAP's wire protocol, both ways: models and renderers behind HTTP, and our planners for external simulators.

Messages are encoded and decoded without sockets, so that client and server share it and are tested as a pair. Notes on
the protocol and its traps: ``docs/extensions/http.md``.
"""
