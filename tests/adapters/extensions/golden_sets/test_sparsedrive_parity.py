"""SparseDrive against the numbers of the official code."""

from pathlib import Path

import pytest
import torch

from adapters.extensions.golden_sets.sparse import GOLDEN as SPARSE
from adapters.models import MODELS
from benchmark.verification.checks import format_report

GOLDEN = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity" / "sparsedrive"
QUANTITIES = {"dev": 70, "fullres": 15}


@pytest.mark.slow
@pytest.mark.skipif(not GOLDEN.is_dir(), reason="no shared material beside the repository")
@pytest.mark.parametrize("name", QUANTITIES)
def test_it_gives_what_the_official_code_gave(name: str) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        checks = SPARSE.verify(MODELS["sparsedrive"], GOLDEN / name)
    finally:
        torch.set_num_threads(threads)
    assert all(check.ok for check in checks), format_report(checks)
    assert len(checks) > QUANTITIES[name]
    assert "in the same order" in checks[0].note
    plans = [check for check in checks if check.quantity.endswith("(m)")]
    assert plans and max(check.error for check in plans) < 1e-4
