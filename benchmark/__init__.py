"""The harness: scenes and data sets, protocols and metrics, runs and their records, the command line."""

__version__ = "0.1.0"
