"""The command line: the one place, beside `benchmark.api`, that knows all packages."""

from benchmark.cli.app import main

__all__ = ["main"]
