"""What a data set's content hash reads."""

from pathlib import Path

import pytest

from benchmark.datasets.fingerprint import compute_fingerprint
from benchmark.errors import InputError
from benchmark.untrusted.files import TABLE
from tests.benchmark.untrusted.variants import write_sparse


def test_a_map_of_nowhere_that_is_longer_than_any_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "maps" / "expansion" / "atlantis.json"
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    known = compute_fingerprint(tmp_path, "v1.0-mini", ())
    path.write_text("[]")
    assert compute_fingerprint(tmp_path, "v1.0-mini", ()) != known
    path.unlink()
    write_sparse(path, TABLE.file_bytes + 1)
    with pytest.raises(InputError, match=r"atlantis\.json"):
        compute_fingerprint(tmp_path, "v1.0-mini", ())
