"""Required content of each nuScenes table: one description, checked when a root is opened and by `data check`."""

from benchmark.datasets.schema.rows import Fault, FaultList, StrictFaultList, check_rows, check_table
from benchmark.datasets.schema.tables import LINKS, SCHEMA, Link, TableField

__all__ = [
    "LINKS",
    "SCHEMA",
    "Fault",
    "FaultList",
    "Link",
    "StrictFaultList",
    "TableField",
    "check_rows",
    "check_table",
]
