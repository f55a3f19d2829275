"""What is compiled here is let go of: tests share processes, and the sampler's programs are large."""

import sys
from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def nothing_compiled_is_kept() -> Iterator[None]:
    """JAX' caches are emptied after a module."""
    yield
    if "jax" in sys.modules:
        import jax

        jax.clear_caches()
