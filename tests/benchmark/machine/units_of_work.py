"""Units of work that worker processes import."""

import os
import signal
import time
from pathlib import Path

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, read_cached_json, read_json, write_json
from benchmark.machine.workers import worker_number


def doubled(item: int) -> int:
    return 2 * item


def number_of_worker(_item: int) -> int:
    # Long enough for both workers to get some.
    time.sleep(0.05)
    return worker_number()


def gpus_in_sight(_item: int) -> str | None:
    return os.environ.get("CUDA_VISIBLE_DEVICES")


def refused(item: int) -> int:
    if item == 2:
        raise InputError("item 2 is broken; leave it out")
    return item


def killed(item: int) -> int:
    if item == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def long(item: int) -> int:
    time.sleep(60.0)
    return item


def announced(folder: str) -> None:
    """Say which process this is, then sleep."""
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(60.0)


def kept_square(folder: Path, seconds: float, item: int) -> int:
    """A resumable unit: its result is found by content key, computed where missing."""
    if not is_kept(folder, item):
        time.sleep(seconds)
        write_json(_path(folder, item), {"item": item, "square": item**2})
    return int(read_json(_path(folder, item))["square"])


def is_kept(folder: Path, item: int) -> bool:
    return read_cached_json(_path(folder, item)) is not None


def _path(folder: Path, item: int) -> Path:
    return folder / f"{content_key('square', item)}.json"


def traced_square(folder: Path, dying: str, since: int, item: int) -> int:
    """`kept_square` that says when it begins and on which Ray node.

    From unit ``since`` on, the dying node never finishes one, and the others wait until it has begun one: however
    slowly it starts, it dies at work.
    """
    import ray

    node = ray.get_runtime_context().get_node_id()
    (folder / f"begun-{item}-{node}").touch()
    deadline_s = time.perf_counter() + 90.0
    while item >= since and time.perf_counter() < deadline_s:
        if node != dying and begun_on(folder, dying, since):
            break
        time.sleep(0.05)
    return kept_square(folder, 0.0, item)


def begun_on(folder: Path, node: str, since: int) -> list[int]:
    """Units from ``since`` on that were begun on a node."""
    begun = (int(path.name.split("-")[1]) for path in folder.glob(f"begun-*-{node}"))
    return [item for item in begun if item >= since]


def threads(_: int) -> int:
    import torch

    return torch.get_num_threads()


def pause(item: int) -> int:
    time.sleep(0.25)
    return item


def busy(seconds: float) -> float:
    """CPU seconds that it used, at least so many."""
    began = time.process_time()
    while time.process_time() - began < seconds:
        pass
    return time.process_time() - began
