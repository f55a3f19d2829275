"""The file of a frozen split: read back as it was written, and one sentence for everything else."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmark.errors import InputError
from generation.splits import format as frozen_format
from generation.splits.format import (
    FrozenAdversary,
    FrozenScene,
    FrozenSplit,
    RecordingsIdentity,
    SceneChoice,
    SearchMetadata,
    read_frozen,
    write_frozen,
)


def adversary(**changes: Any) -> FrozenAdversary:
    values = {"instance": "a" * 32, "launch_frame": 3, "recorded": (1.5, 2.0, 0.1), "track": ((1.5, 2.0, 0.1),) * 4}
    return FrozenAdversary(**{**values, **changes})


def scene(name: str = "scene-0001-ab", **changes: Any) -> FrozenScene:
    values = {"name": name, "source": "scene-0001", "adversaries": (adversary(),), "tables": "0" * 64}
    return FrozenScene(**{**values, **changes})


def split() -> FrozenSplit:
    return FrozenSplit(
        recordings=RecordingsIdentity(name="road", fingerprint="f"),
        search=SearchMetadata(algorithm="3", hyper="h", prior="p", seed=0),
        chosen=SceneChoice(scenes=1, tried=2, survived=2, per_scene=None, total=None, surrogate=None),
        images=None,
        scenes=(scene(), scene("scene-0001-cd", adversaries=(adversary(launch_frame=4),))),
    )


def test_what_is_written_is_read_and_a_scene_is_a_line(tmp_path: Path) -> None:
    file = tmp_path / "road-adv-1.json"
    write_frozen(file, split())
    assert read_frozen(file) == split()
    assert read_frozen(file).content_id == split().content_id
    lines = [line for line in file.read_text().splitlines() if line.startswith('{"adversaries"')]
    assert len(lines) == 2
    write_frozen(file, split())


def test_another_split_never_takes_its_place(tmp_path: Path) -> None:
    file = tmp_path / "road-adv-1.json"
    write_frozen(file, split())
    before = file.read_bytes()
    with pytest.raises(InputError, match="another frozen split"):
        write_frozen(file, split().model_copy(update={"scenes": (scene(),)}))
    assert file.read_bytes() == before


def changed(path: list[str | int], value: Any) -> str:
    """The file's text with one value changed."""
    whole = json.loads(split().text())
    inner = whole
    for step in path[:-1]:
        inner = inner[step]
    inner[path[-1]] = value
    return json.dumps(whole)


TRACK: list[str | int] = ["scenes", 0, "adversaries", 0, "track"]
BAD = {
    "truncated": (split().text()[:-200], "not valid JSON"),
    "empty": ("", "not valid JSON"),
    "a list": ("[]", "is not a frozen split"),
    "something else": ('{"scenes": []}', "is not a frozen split"),
    "a newer version": (changed(["schema"], 3), "upgrade"),
    "a driven ego without its tracks": (changed(["schema"], 2), "a split with a driven ego has format 2"),
    "no version": (changed(["schema"], None), "upgrade"),
    "true as version": (changed(["schema"], True), "upgrade"),
    "not a number": (changed([*TRACK, 0, 0], float("nan")), "scenes.0.adversaries.0.track.0.0"),
    "infinity": (changed([*TRACK, 0, 0], float("inf")), "track.0.0"),
    "a number as text": (changed([*TRACK, 0, 0], "1.0"), "track.0.0"),
    "beyond the world": (changed([*TRACK, 0, 0], 1e300), "track.0.0"),
    "a pose without heading": (changed([*TRACK, 0], [1.0, 2.0]), "track.0"),
    "no track": (changed(TRACK, []), "track"),
    "a frame before the first": (changed(["scenes", 0, "adversaries", 0, "launch_frame"], -1), "launch_frame"),
    "half a frame": (changed(["scenes", 0, "adversaries", 0, "launch_frame"], 1.5), "launch_frame"),
    "no adversary": (changed(["scenes", 0, "adversaries"], []), "adversaries"),
    "an adversary twice": (
        changed(["scenes", 0, "adversaries"], [adversary().model_dump(mode="json")] * 2),
        "adversary twice",
    ),
    "no scenes": (changed(["scenes"], []), "scenes"),
    "a scene twice": (changed(["scenes", 1, "name"], "scene-0001-ab"), "two scenes"),
    "a name that leaves its folder": (changed(["scenes", 0, "name"], "../scene-0001"), "name"),
    "a name of another scene": (changed(["scenes", 0, "name"], "scene-0002-ab"), "not named after"),
    "something unknown": (changed(["extra"], 1), "extra"),
    "no hash": (changed(["scenes", 0, "tables"], "abc"), "tables"),
    "another split": (changed(["split"], "val"), "split"),
    "deep": ("[" * 100_000, "JSON"),
}


@pytest.mark.parametrize("what", BAD)
def test_anything_else_is_refused_in_one_sentence(tmp_path: Path, what: str) -> None:
    text, word = BAD[what]
    file = tmp_path / "bad.json"
    file.write_text(text)
    with pytest.raises(InputError, match=word) as refused:
        read_frozen(file)
    assert str(file) in str(refused.value) and "\n" not in str(refused.value)


def test_bytes_that_are_no_text_and_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "bytes.json", tmp_path, tmp_path / "absent.json"):
        with pytest.raises(InputError, match=path.name):
            read_frozen(path)


def test_a_huge_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frozen_format, "MOST_BYTES", 100)
    file = tmp_path / "huge.json"
    write_frozen(file, split())
    with pytest.raises(InputError, match="bytes"):
        read_frozen(file)
