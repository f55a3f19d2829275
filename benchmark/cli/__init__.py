"""The command line: the one place, beside `benchmark.api`, that knows all packages."""
