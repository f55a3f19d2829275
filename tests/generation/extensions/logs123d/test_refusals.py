"""Logs that are refused: in one sentence that says what and where, with nothing written."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pyarrow as pa
import pytest

from benchmark.errors import InputError
from generation.extensions.logs123d.importing import LogImport, import_123d
from tests.benchmark.cli.cli_runs import run_main
from tests.generation.extensions.logs123d.damaged_logs import DAMAGES, damage
from tests.generation.extensions.logs123d.made_logs import MadeLog, picture, write_arrow

SMALL = MadeLog(frames=6, cameras={"pcam_f0": ("front", 0.0)})


def refused(data: Path, settings: LogImport | None = None) -> str:
    """The one sentence; the root has nothing of the log."""
    with pytest.raises(InputError) as error:
        import_123d(data / "logs", data / "root", settings)
    assert "\n" not in str(error.value)
    assert not [path for path in (data / "root").glob("[sv]*/**/*") if path.is_file()]
    return str(error.value)


def test_versions_and_modalities_that_are_not_known_are_named(tmp_path: Path) -> None:
    replace(SMALL, version="0.8.0").write(tmp_path / "newer")
    assert "'0.8.0'" in refused(tmp_path / "newer")
    folder = SMALL.write(tmp_path / "more")
    write_arrow(folder / "thermal.left.arrow", {"thermal.left.timestamp_us": [0]}, {})
    assert "thermal.left" in refused(tmp_path / "more")


def test_modalities_without_a_place_in_nuscenes_are_left_out_by_name(tmp_path: Path) -> None:
    folder = SMALL.write(tmp_path)
    write_arrow(folder / "traffic_light_detections.arrow", {"traffic_light_detections.timestamp_us": [0]}, {})
    write_arrow(folder / "custom.mood.arrow", {"custom.mood.timestamp_us": [0]}, {})
    (log,) = import_123d(tmp_path / "logs", tmp_path / "root")
    assert {"custom.mood", "traffic_light_detections"} <= {*log.facts["left_out"]}


def test_labels_that_are_not_known_are_named(tmp_path: Path) -> None:
    replace(SMALL, label_class="somebody.SpaceLabel").write(tmp_path)
    assert "somebody.SpaceLabel" in refused(tmp_path)


def test_names_that_could_lead_elsewhere_are_refused(tmp_path: Path) -> None:
    replace(SMALL, location="../../etc").write(tmp_path / "place")
    assert "location" in refused(tmp_path / "place", LogImport(maps=tmp_path))
    replace(SMALL, cameras={"pcam_f0": ("../front", 0.0)}).write(tmp_path / "camera")
    assert "camera_name" in refused(tmp_path / "camera")
    made = replace(SMALL, storage="string", cameras={"pcam_f0": ("front", 0.0)})
    folder = made.write(tmp_path / "paths")
    table = pa.ipc.open_file(str(folder / "camera.pcam_f0.arrow")).read_all()
    away = pa.array(["../../secret.jpg"] * len(table))
    changed = table.set_column(1, "camera.pcam_f0.data", away)
    with pa.ipc.new_file(str(folder / "camera.pcam_f0.arrow"), changed.schema) as writer:
        writer.write_table(changed)
    assert "does not lie below --sensors" in refused(tmp_path / "paths", LogImport(sensors=tmp_path))


def test_images_that_are_files_need_their_folder(tmp_path: Path) -> None:
    made = replace(SMALL, storage="string")
    made.write(tmp_path)
    assert "--sensors" in refused(tmp_path)
    (tmp_path / "sensors" / "front").mkdir(parents=True)
    for row in range(made.frames):
        (tmp_path / "sensors" / "front" / f"{row:03d}.jpg").write_bytes(picture(row))
    settings = LogImport(sensors=tmp_path / "sensors")
    import_123d(tmp_path / "logs", tmp_path / "root", settings)
    samples = sorted((tmp_path / "root" / "samples" / "front").iterdir())
    assert [path.read_bytes() for path in samples] == [picture(0), picture(5)]
    (tmp_path / "sensors" / "front" / "003.jpg").unlink()
    with pytest.raises(InputError, match=r"003\.jpg is missing"):
        import_123d(tmp_path / "logs", tmp_path / "other", settings)


def test_an_image_that_is_cut_short_takes_its_log_along(tmp_path: Path) -> None:
    folder = SMALL.write(tmp_path)
    table = pa.ipc.open_file(str(folder / "camera.pcam_f0.arrow")).read_all()
    images = [picture(row) for row in range(5)] + [picture(5)[:-300]]
    changed = table.set_column(1, "camera.pcam_f0.data", pa.array(images))
    with pa.ipc.new_file(str(folder / "camera.pcam_f0.arrow"), changed.schema) as writer:
        writer.write_table(changed)
    assert "row 5" in refused(tmp_path)


def test_an_ego_that_ends_early_is_not_made_to_stand(tmp_path: Path) -> None:
    folder = replace(SMALL, frames=11).write(tmp_path)
    table = pa.ipc.open_file(str(folder / "ego_state_se3.arrow")).read_all()
    with pa.ipc.new_file(str(folder / "ego_state_se3.arrow"), table.schema) as writer:
        writer.write_table(table.slice(0, 6))
    assert "ego_state_se3" in refused(tmp_path)


def test_without_msgpack_the_command_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    SMALL.write(tmp_path)
    found = __import__("importlib.util").util.find_spec
    monkeypatch.setattr(
        "importlib.util.find_spec", lambda name, *more: None if name == "msgpack" else found(name, *more)
    )
    done = run_main("data", "import", "123d", tmp_path / "logs", "--out", tmp_path / "root", "--workers", "1")
    assert done.code == 2 and "pip install 'challenger-bench[123d]'" in done.err and done.err.count("\n") == 1


def test_a_column_that_inflates_costs_no_memory(tmp_path: Path) -> None:
    folder = SMALL.write(tmp_path)
    zeros = pa.array(np.zeros(1 << 27, np.int64))
    schema = pa.schema([pa.field("sync.timestamp_us", pa.int64())], metadata={b"metadata": msgpack.packb({})})
    stream = io.BytesIO()
    with pa.ipc.new_file(stream, schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as writer:
        for _ in range(2):
            writer.write_batch(pa.record_batch([zeros], schema=schema))
    (folder / "sync.arrow").write_bytes(stream.getvalue())
    said = refused(tmp_path)
    assert "memory" in said or "more than" in said


@pytest.mark.parametrize("number", range(len(DAMAGES)))
def test_a_damaged_log_is_read_or_refused(tmp_path: Path, number: int) -> None:
    folder = SMALL.write(tmp_path)
    found, _ = damage(folder, number, seed=3)
    try:
        import_123d(tmp_path / "logs", tmp_path / "root")
    except InputError as error:
        said: Any = str(error)
        assert "\n" not in said and not list((tmp_path / "root").glob("v*/*.json"))
    else:
        assert found.may_be_valid
