"""What `challenger-bench verify` prints: one line per quantity, the largest error and how much is allowed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Check:
    """One quantity compared with its golden values.

    Attributes:
        quantity: Name, with unit where it has one.
        error: Largest difference; for verdicts, the number of wrong ones.
        tolerance: Largest difference that is allowed.
        count: Values compared.
        note: What else a reader should know, for example what was left out and why.
    """

    quantity: str
    error: float
    tolerance: float
    count: int
    note: str = ""

    @property
    def ok(self) -> bool:
        """Whether the error is allowed; NaN never is, and nothing compared is not a success."""
        return bool(self.count > 0 and np.isfinite(self.error) and self.error <= self.tolerance)


def report(checks: Sequence[Check]) -> str:
    """One line per quantity and a closing sentence.

    Args:
        checks: In the order to print.

    Returns:
        Lines of text.
    """
    width = max((len(check.quantity) for check in checks), default=0)
    lines = [
        f"{'ok  ' if check.ok else 'FAIL'}  {check.quantity:<{width}}  largest error {check.error:9.3g}, "
        f"allowed {check.tolerance:9.3g}, {check.count:,} values{f' ({check.note})' if check.note else ''}"
        for check in checks
    ]
    failed = sum(not check.ok for check in checks)
    return "\n".join([*lines, f"{len(checks) - failed} of {len(checks)} quantities agree"])
