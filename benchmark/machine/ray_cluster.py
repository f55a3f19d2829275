"""Work on many items with a Ray cluster: the units, their order and their bytes are those of `LocalProcesses`.

Units find and keep finished work by content key in a folder that all nodes share, so a unit that is run again, because
its node was lost, does no harm.
"""

import contextlib
import functools
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from benchmark.errors import InputError
from benchmark.machine.environment import read_package_versions
from benchmark.machine.progress import PROGRESS_REPORTER, CountedUnits, WorkProgress
from benchmark.machine.storage import content_key, file_sha256
from benchmark.machine.workers import report_when_done, results_in_order, single_threaded

Item = TypeVar("Item")
Result = TypeVar("Result")

LOCAL_OBJECT_STORE_BYTES: Final = 200 * 10**6
"""Shared memory of a Ray that is started here: scenes on their way to workers, a few MB each."""
CONNECTION_S: Final = 5.0
"""How long an address may take to accept a connection."""
ANSWER_S: Final = 20.0
"""How long a cluster may take to say that it is well; one that is takes some three seconds."""
NOT_INSTALLED: Final = (
    "the executor ray needs the package Ray, which is not installed; install challenger-bench[ray] on all nodes"
)
_ADVICE: Final = "start it with ray start --head and give the HOST:PORT that it prints as --address"
_PACKAGES: Final = ("adapters", "benchmark", "generation", "leaderboard")


@dataclass(frozen=True, slots=True)
class RayCluster:
    """The processors of a Ray cluster, one unit on each; or its GPUs.

    The command runs on one of the nodes. All nodes have the same version of this project installed and see data and
    output at the same paths.

    Attributes:
        address: HOST:PORT of the head, ``auto`` for the cluster of this machine, ``ray://HOST:PORT`` for a Ray client,
            or ``None`` to start Ray on this machine.
        retries: How often a unit is given to another worker when its own is lost; its own errors are not tried again.
        gpus: GPUs of a unit, which sees no others; 0 for units that need none.
    """

    address: str | None = "auto"
    retries: int = 3
    gpus: int = 0

    def map(
        self,
        function: Callable[[Item], Result],
        items: Iterable[Item],
        *,
        total: int,
        label: str,
        count: CountedUnits | None = None,
    ) -> Iterator[Result]:
        """Apply a function to items and give the results in the order of the items.

        No Ray, a cluster that cannot be joined, a node with other code, or units lost too often raise `InputError`.
        """
        # Ray reports lost workers on stdout, where a command may print JSON.
        with (
            contextlib.redirect_stdout(sys.stderr),
            _connected(self.address) as ray,
            PROGRESS_REPORTER.work(label, total, count or CountedUnits()) as work,
        ):
            yield from self._results(ray, function, items, label, work)

    def _results(
        self, ray: Any, function: Callable[[Item], Result], items: Iterable[Item], label: str, work: WorkProgress
    ) -> Iterator[Result]:
        unit = ray.remote(num_cpus=1, num_gpus=self.gpus, max_retries=self.retries)(_unit)
        shared, expected = ray.put(function), _code_fingerprint()
        running: set[Any] = set()

        def submit(item: Item) -> "Future[Result]":
            reference = unit.remote(shared, expected, item)
            running.add(reference)
            future: Future[Result] = reference.future()
            future.add_done_callback(lambda _: running.discard(reference))
            return report_when_done(future, work)

        try:
            yield from results_in_order(submit, items, _count_slots(ray, self.address, self.gpus))
        except ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except ray.exceptions.RayError as error:
            raise InputError(
                f"a unit of work was lost on the Ray cluster ({label}; {_first_line(error)}); check the nodes, then "
                "run the same command again (finished work is kept)"
            ) from error
        finally:
            for reference in list(running):
                ray.cancel(reference, force=True)


def _unit(function: Callable[[Item], Result], expected: str, item: Item) -> Result:
    if _code_fingerprint() != expected:
        raise InputError(
            f"the Ray node {socket.gethostname()} has another version of challenger-bench, numpy or torch than the "
            "node of the command; install the same versions on all nodes"
        )
    single_threaded()
    return function(item)


@functools.cache
def _code_fingerprint() -> str:
    """Of everything that a unit's bytes depend on and that is installed on each node by itself."""
    root = Path(__file__).resolve().parents[2]
    files = (path for package in _PACKAGES for path in sorted((root / package).rglob("*")))
    sources = [path for path in files if path.is_file() and path.parent.name != "__pycache__"]
    # CPU and CUDA builds of a package count as the same version.
    versions = {name: version and version.partition("+")[0] for name, version in read_package_versions().items()}
    return content_key(versions, {str(path.relative_to(root)): file_sha256(path) for path in sources})


@contextlib.contextmanager
def _connected(address: str | None) -> Iterator[Any]:
    """The ray module, connected; a connection that was there before is used and stays."""
    try:
        import ray
        import ray.exceptions
    except ImportError as error:
        raise InputError(NOT_INSTALLED) from error
    if ray.is_initialized():
        yield ray
        return
    # A benchmark must not send usage statistics.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray announces with a warning that it will change what it means to ask for no accelerators.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    where: dict[str, Any] = {"address": "local", "include_dashboard": False}
    if address is None:
        where["object_store_memory"] = LOCAL_OBJECT_STORE_BYTES
    else:
        where = {"address": address}
        require_answer(address)
    try:
        # Output of workers would mix with the command's own.
        ray.init(**where, log_to_driver=False, logging_level="ERROR")
    except (ConnectionError, OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        raise InputError(
            f"cannot join the Ray cluster at {address}: {_first_line(error)}; start a node of it on this machine with "
            "ray start, with the same versions of Python and Ray, and where it asks for a token, set "
            "RAY_AUTH_MODE=token"
        ) from error
    try:
        yield ray
    finally:
        ray.shutdown()


@functools.cache
def require_answer(address: str) -> None:
    """Find out soon whether a cluster is there; Ray waits for minutes where nothing answers, or something else.

    The address is HOST:PORT, ``ray://HOST:PORT``, or ``auto`` for what Ray finds on this machine.
    """
    if address != "auto":
        host, _, port = address.removeprefix("ray://").rpartition(":")
        if not host or not port.isdigit() or not 0 < int(port) < 65536:
            raise InputError(f"the address of a Ray cluster is HOST:PORT, auto or ray://HOST:PORT, not {address!r}")
        try:
            socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECTION_S).close()
        except OSError as error:
            raise InputError(f"no Ray cluster answers at {address} ({error.strerror or error}); {_ADVICE}") from error
    if not address.startswith("ray://") and not _is_healthy(address):
        raise InputError(f"no Ray cluster answers at {address}; {_ADVICE}")


def _is_healthy(address: str) -> bool:
    """Whether Ray's own check succeeds, in a subprocess because it has no timeout."""
    where = [] if address == "auto" else ["--address", address]
    check = [sys.executable, "-m", "ray.scripts.scripts", "health-check", *where]
    try:
        return subprocess.run(check, capture_output=True, timeout=ANSWER_S, check=False).returncode == 0
    except subprocess.TimeoutExpired:
        return False


def _count_slots(ray: Any, address: str | None, gpus: int) -> int:
    resources = ray.cluster_resources()
    for resource, needed, resource_name in (("CPU", 1, "processors"), ("GPU", gpus, "GPUs")):
        if resources.get(resource, 0) < needed:
            raise InputError(
                f"the Ray cluster at {address} has no {resource_name} to work on; add a node that has some with ray "
                "start --address=HOST:PORT"
            )
    processors = int(resources["CPU"])
    return min(processors, int(resources["GPU"]) // gpus) if gpus else processors


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".;")
