"""Where the golden sets in the package are."""

from pathlib import Path
from typing import Final

BUILT_IN: Final = Path(__file__).parent / "golden"
"""One folder each for ``physics``, ``scoring`` and ``denoiser``, in the same form as any other golden set."""
