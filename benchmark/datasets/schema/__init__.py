"""What each nuScenes table must hold: one description, checked when a root is opened and by `data check`."""

from benchmark.datasets.schema.rows import Fault, FaultList, Refusal, check_rows, check_table
from benchmark.datasets.schema.tables import LINKS, SCHEMA, Field, Link

__all__ = ["LINKS", "SCHEMA", "Fault", "FaultList", "Field", "Link", "Refusal", "check_rows", "check_table"]
