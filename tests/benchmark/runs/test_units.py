"""One store of finished work: what is kept is what was put there, or nothing."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, field_serializer

from benchmark.errors import InputError
from benchmark.runs.units import ResultStore


class Measured(BaseModel):
    value: float
    seen: tuple[str, ...] = ()


def store_in(folder: Path) -> ResultStore[Measured]:
    return ResultStore(folder, Measured)


def test_what_was_put_there_is_found_under_its_key_alone(tmp_path: Path) -> None:
    store, made = store_in(tmp_path), Measured(value=0.1 + 0.2, seen=("a", "ä"))
    assert store.get("key", "scene/1") is None
    store.put("key", made, "scene/1")
    assert store.get("key", "scene/1") == made
    assert store.get("another", "scene/1") is None and store.get("key", "scene/2") is None
    store.put("another", Measured(value=1.0), "scene/1")
    assert store.get("key", "scene/1") is None


@given(place=st.integers(0, 10**6), byte=st.integers(0, 255))
def test_any_changed_byte_is_noticed(tmp_path_factory: pytest.TempPathFactory, place: int, byte: int) -> None:
    folder = tmp_path_factory.mktemp("store")
    store, made = store_in(folder), Measured(value=2.5, seen=("x",))
    store.put("key", made)
    path = store.path("key")
    whole = bytearray(path.read_bytes())
    place %= len(whole)
    same, whole[place] = whole[place] == byte, byte
    path.write_bytes(whole)
    assert store.get("key") == (made if same else None)


@pytest.mark.parametrize("content", [b"", b"\n", b"{}", b"[1]\n2\n", b"\0" * 100, b'{"key":"key"}\n{"value":1.0}\n'])
def test_what_is_none_of_its_files_is_nothing(tmp_path: Path, content: bytes) -> None:
    store = store_in(tmp_path)
    store.path("key").write_bytes(content)
    assert store.get("key") is None


def test_a_result_of_another_form_is_nothing(tmp_path: Path) -> None:
    other: ResultStore[dict[str, str]] = ResultStore(tmp_path, dict[str, str])
    other.put("key", {"value": "many"})
    assert store_in(tmp_path).get("key") is None


def test_numbers_that_are_not_finite_are_not_kept(tmp_path: Path) -> None:
    store: ResultStore[list[float]] = ResultStore(tmp_path, list[float])
    with pytest.raises(ValueError, match="JSON"):
        store.put("key", [float("nan")])
    assert not list(tmp_path.iterdir())


class Interrupted(BaseModel):
    value: float

    @field_serializer("value")
    def _write(self, value: float) -> float:
        raise KeyboardInterrupt


def test_an_interruption_while_a_result_is_put_into_words_is_one(tmp_path: Path) -> None:
    store: ResultStore[Interrupted] = ResultStore(tmp_path, Interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.put("key", Interrupted(value=1.0))
    assert not store.path("key").exists()


def test_the_rest_is_tidied_away(tmp_path: Path) -> None:
    store = store_in(tmp_path / "rows")
    store.tidy(["nothing is there yet"])
    for name in ("one", "two"):
        store.put("key", Measured(value=1.0), name)
    (tmp_path / "rows" / ".one.json.part").write_bytes(b"left")
    store.tidy(["two"])
    assert [path.name for path in (tmp_path / "rows").iterdir()] == ["two.json"]


def test_a_folder_that_is_a_file_is_said(tmp_path: Path) -> None:
    (tmp_path / "rows").write_text("")
    store = store_in(tmp_path / "rows")
    assert store.get("key") is None
    with pytest.raises(InputError, match="cannot write"):
        store.put("key", Measured(value=1.0))
