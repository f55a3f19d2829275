from pathlib import Path

import pytest

from benchmark.errors import InputError
from benchmark.machine.storage import only_writer, read_kept_json


def test_only_one_writer_at_a_time(tmp_path: Path) -> None:
    second = only_writer(tmp_path / "new")
    with only_writer(tmp_path / "new"), pytest.raises(InputError, match="another command is writing"):
        second.__enter__()
    with only_writer(tmp_path / "new"):
        assert not list((tmp_path / "new").iterdir())


@pytest.mark.parametrize("data", [b"", b"{", b"\xff\xfe", None])
def test_damaged_work_is_as_good_as_none(tmp_path: Path, data: bytes | None) -> None:
    if data is not None:
        (tmp_path / "kept.json").write_bytes(data)
    assert read_kept_json(tmp_path / "kept.json") is None
