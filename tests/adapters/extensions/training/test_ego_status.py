"""Ego status learns from tracks: what it is shown, that it is the same each time, and what is refused."""

from collections.abc import Callable
from dataclasses import replace
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


@pytest.mark.path
def test_training_twice_gives_the_same_bytes_and_learns_to_speed_up(tmp_path: Path) -> None:
    write_tracks(tmp_path / "line.npz", lambda time: (7 * time + 0.4 * time**2, 0 * time, 0 * time))
    few = TrainingSettings(sources=("line",), held_out=("line",), steps=200, batch=32)
    paths = [tmp_path / f"{name}.safetensors" for name in ("one", "two", "three")]
    figures = [
        train_ego_status(tmp_path, path, seed=seed, settings=few)["line"] for path, seed in zip(paths, (0, 0, 1))
    ]
    one, two, three = (path.read_bytes() for path in paths)
    assert one == two != three and EgoStatus(paths[0]).weights_sha256
    assert figures[0]["samples"] == len(read_samples(tmp_path, ["line"])["line"])
    assert figures[0]["l2_3s"] < figures[0]["constant_velocity_l2_3s"]
    with pytest.raises(InputError, match="gone"):
        train_ego_status(tmp_path, tmp_path / "none", settings=replace(few, held_out=("gone",)))
    assert not (tmp_path / "none").exists()


def test_unusable_tracks_are_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_bytes(b"not an archive")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    write_tracks(tmp_path / "twelve.npz", lambda time: (9 * time, 0 * time, 0 * time), hz=12.0)
    write_tracks(tmp_path / "parked.npz", lambda time: (0 * time, 0 * time, 0 * time))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "parked.npz").read_bytes()[:400])
    for name, says in (
        ("nothing", "no track file"),
        ("text", "cannot read the tracks"),
        ("other", "not a track file"),
        ("twelve", "12 samples per second"),
        ("parked", "no vehicle that moves"),
        ("cut", "fetch or make the file again"),
    ):
        with pytest.raises(InputError, match=says):
            read_samples(tmp_path, [name])


@pytest.mark.skipif(not SHARED_TRACKS.is_dir(), reason="the recorded tracks are not beside this checkout")
def test_recorded_tracks_are_driveable_samples() -> None:
    samples = read_samples(SHARED_TRACKS, ["ngsim_commonroad"])["ngsim_commonroad"]
    assert len(samples) > 300
    assert np.isfinite(samples.future).all() and np.linalg.norm(samples.future, axis=-1).max() < 3 * 45
