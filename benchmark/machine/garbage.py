"""Reading many values without Python's collector passing over all of them again and again."""

import gc


def collect_rarely() -> None:
    """Let this process look for reference cycles a hundred times less often: commands end soon and make few."""
    gc.set_threshold(100_000, 20, 50)
