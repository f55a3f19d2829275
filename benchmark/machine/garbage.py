"""Reading many values without Python's collector passing over all of them again and again.

What is read is kept, so that there is nothing to collect; looking for it took three quarters of the time of reading a
large record.
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def uncollected() -> Iterator[None]:
    """No collection of reference cycles inside; as it was before afterwards."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def collect_rarely() -> None:
    """Let this process look for reference cycles a hundred times less often: commands end soon and make few."""
    gc.set_threshold(100_000, 20, 50)
