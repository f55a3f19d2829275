"""The table checker: what is wrong with a nuScenes-format data set, in sentences."""

from benchmark.datasets.integrity.check import check_tables
from benchmark.datasets.schema import Fault

__all__ = ["Fault", "check_tables"]
