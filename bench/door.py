"""What the door costs: a checkpoint of 2 GB and a recording, read through it and as they were read before it."""

import argparse
import pickle
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

MOST_TIMES = 1.3
"""How many times as long as before a checkpoint of 2 GB may take."""


def checkpoint_before(path: Path) -> float:
    """Checksums, then PyTorch's weights-only reader, mapped: the sum of all numbers that are asked for."""
    import torch

    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        tensors = torch.load(path, map_location="cpu", weights_only=True, mmap=True)["state_dict"]
    return sum(float(tensor.sum(dtype=torch.float64)) for tensor in tensors.values())


def checkpoint_through_the_door(path: Path) -> float:
    import torch

    from benchmark.weights.foreign import read_checkpoint

    tensors = read_checkpoint(path).tensors
    return sum(float(tensor.sum(dtype=torch.float64)) for tensor in tensors.values())


def recording_before(path: Path) -> float:
    """In this process, with the allow-list alone."""
    from benchmark.untrusted.allowed import AllowListUnpickler

    with path.open("rb") as stream:
        return float(sum(track["position"].sum() for track in AllowListUnpickler(stream).load().values()))


def recording_through_the_door(path: Path) -> float:
    from benchmark.untrusted.pickles import read_pickle

    return float(sum(track["position"].sum() for track in read_pickle(path).values()))


def write_checkpoint(path: Path, gigabytes: float) -> None:
    """As mmcv writes them: weights, and moments of an optimizer that are twice as large."""
    import torch

    side, tensors = 2048, max(3, round(gigabytes * (1 << 30) / (4 * 2048 * 2048)))
    made = torch.Generator().manual_seed(0)
    weights = [torch.randn(side, side, generator=made) for _ in range(tensors // 3)]
    moments = {number: {"exp_avg": each + 1, "exp_avg_sq": each * each} for number, each in enumerate(weights)}
    held = {f"layers.{number}.weight": each for number, each in enumerate(weights)}
    torch.save({"meta": {"epoch": 1}, "state_dict": held, "optimizer": {"state": moments}}, path)


def write_recording(path: Path) -> None:
    """As many objects and steps as a crowded scene of nuScenes has."""
    rng = np.random.default_rng(0)
    tracks = {str(number): {"position": rng.standard_normal((200, 3)), "type": "VEHICLE"} for number in range(300)}
    path.write_bytes(pickle.dumps(tracks))


def seconds(read: Callable[[Path], float], path: Path, repeats: int) -> tuple[float, float]:
    """Best of some runs, so that the first one's imports and the disk do not count; and what was read."""
    best, found = float("inf"), 0.0
    for _ in range(repeats):
        start = time.perf_counter()
        found = read(path)
        best = min(best, time.perf_counter() - start)
    return best, found


def compare(name: str, path: Path, before: Any, door: Any, repeats: int) -> float:
    before_s, expected = seconds(before, path, repeats)
    door_s, found = seconds(door, path, repeats)
    assert found == expected, (found, expected)
    print(f"{name:<28}{before_s:8.3f} s before {door_s:8.3f} s through the door {door_s / before_s:8.2f} times")
    return door_s / before_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where there is room; what is written there is removed again")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        checkpoint, recording = Path(folder) / "large.pth", Path(folder) / "recording.pkl"
        write_checkpoint(checkpoint, arguments.gigabytes)
        write_recording(recording)
        times = compare(
            f"checkpoint, {checkpoint.stat().st_size / (1 << 30):.2f} GB",
            checkpoint,
            checkpoint_before,
            checkpoint_through_the_door,
            arguments.repeats,
        )
        compare("recording", recording, recording_before, recording_through_the_door, arguments.repeats)
    if arguments.gigabytes >= 1 and times > MOST_TIMES:
        raise SystemExit(f"a checkpoint takes {times:.2f} times as long as before, at most {MOST_TIMES} are meant")


if __name__ == "__main__":
    main()
