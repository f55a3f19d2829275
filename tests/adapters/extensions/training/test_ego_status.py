"""Ego status learns from tracks: what it is shown, that it is the same each time, and what is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from adapters.extensions.training.ego_status import HZ, TrainingSettings, read_samples, train_ego_status
from adapters.planners.ego_status import EgoStatus
from benchmark.errors import InputError
from benchmark.geometry import Floats

SHARED_TRACKS = Path(__file__).resolve().parents[5] / "shared" / "data" / "trajectories"


def write_tracks(path: Path, path_of: Callable[[Floats], tuple[Floats, ...]], *, hz: float = HZ) -> None:
    time = np.arange(12 * HZ) / HZ
    x, y, heading = path_of(time)
    np.savez(
        path,
        ptr=np.array([0, len(time)]),
        x=x.astype(np.float32),
        y=y.astype(np.float32),
        heading=heading.astype(np.float32),
        length=np.array([4.5], np.float32),
        cls=np.array(["car"]),
        is_ego=np.array([True]),
        hz=np.array(hz),
        source=np.array("made_up"),
        licence=np.array("none"),
    )


def test_samples_of_a_track_are_its_motion(tmp_path: Path) -> None:
    radius, speed = 30.0, 6.0

    def circle(time: Floats) -> tuple[Floats, ...]:
        turn = speed * time / radius
        return radius * np.sin(turn), radius * (1 - np.cos(turn)), turn

    write_tracks(tmp_path / "circle.npz", circle)
    samples = read_samples(tmp_path, ["circle"])["circle"]
    assert samples.motion.velocity[:, 0] == pytest.approx(speed, abs=0.1)
    assert samples.motion.yaw_rate == pytest.approx(speed / radius, abs=0.01)
    turned = speed * 3.0 / radius
    assert samples.future[:, 5] == pytest.approx(
        np.tile([radius * np.sin(turned), radius * (1 - np.cos(turned))], (len(samples), 1)), abs=0.1
    )
    assert (samples.motion.command == 1).all()


def test_training_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    write_tracks(tmp_path / "line.npz", lambda time: (7 * time + 0.4 * time**2, 0 * time, 0 * time))
    few = TrainingSettings(sources=("line",), held_out=("line",), steps=20, batch=32)
    for name in ("one", "two"):
        train_ego_status(tmp_path, tmp_path / f"{name}.safetensors", settings=few)
    assert (tmp_path / "one.safetensors").read_bytes() == (tmp_path / "two.safetensors").read_bytes()
    assert EgoStatus(tmp_path / "one.safetensors").weights_sha256
    other = train_ego_status(tmp_path, tmp_path / "three.safetensors", seed=1, settings=few)
    assert other["line"]["samples"] == len(read_samples(tmp_path, ["line"])["line"])
    assert (tmp_path / "one.safetensors").read_bytes() != (tmp_path / "three.safetensors").read_bytes()


def test_nothing_is_written_that_cannot_be_measured(tmp_path: Path) -> None:
    write_tracks(tmp_path / "line.npz", lambda time: (7 * time, 0 * time, 0 * time))
    few = TrainingSettings(sources=("line",), held_out=("gone",), steps=1, batch=8)
    with pytest.raises(InputError, match="gone"):
        train_ego_status(tmp_path, tmp_path / "one.safetensors", settings=few)
    assert not (tmp_path / "one.safetensors").exists()


def test_unusable_tracks_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no track file"):
        read_samples(tmp_path, ["nothing"])
    (tmp_path / "text.npz").write_bytes(b"not an archive")
    with pytest.raises(InputError, match="cannot read the tracks"):
        read_samples(tmp_path, ["text"])
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="not a track file"):
        read_samples(tmp_path, ["other"])
    write_tracks(tmp_path / "twelve.npz", lambda time: (9 * time, 0 * time, 0 * time), hz=12.0)
    with pytest.raises(InputError, match="12 samples per second"):
        read_samples(tmp_path, ["twelve"])
    write_tracks(tmp_path / "cut.npz", lambda time: (9 * time, 0 * time, 0 * time))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "cut.npz").read_bytes()[:400])
    with pytest.raises(InputError, match="fetch or make the file again"):
        read_samples(tmp_path, ["cut"])
    write_tracks(tmp_path / "parked.npz", lambda time: (0 * time, 0 * time, 0 * time))
    with pytest.raises(InputError, match="no vehicle that moves"):
        read_samples(tmp_path, ["parked"])


@pytest.mark.skipif(not SHARED_TRACKS.is_dir(), reason="the recorded tracks are not beside this checkout")
def test_recorded_tracks_are_driveable_samples() -> None:
    samples = read_samples(SHARED_TRACKS, ["ngsim_commonroad"])["ngsim_commonroad"]
    assert len(samples) > 300
    assert np.isfinite(samples.future).all() and np.linalg.norm(samples.future, axis=-1).max() < 3 * 45
