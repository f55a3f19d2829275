"""Work on many items with this machine's processes, in order, saying how far it is.

Results come in the order of the items for any number of workers; every process computes with one thread, so that
one worker and many give the same bytes. Items are drawn only a little ahead of the results: they may be large.
"""

import functools
import gc
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from multiprocessing.util import Finalize
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from benchmark.errors import InputError
from benchmark.machine.progress import PROGRESS_REPORTER, CountedUnits, WorkProgress, track_progress

if TYPE_CHECKING:
    from multiprocessing.sharedctypes import Synchronized


def collect_rarely() -> None:
    """Let this process look for reference cycles a hundred times less often: commands end soon and make few."""
    gc.set_threshold(100_000, 20, 50)


Item = TypeVar("Item")
Result = TypeVar("Result")

UNFINISHED_PER_WORKER: Final = 3
"""Units handed out to each worker: one that it works on, the others so that it never waits."""
WAITING_PER_WORKER: Final = 60
"""Finished and unfinished units for each worker; one slow unit holds up the results of no more than these."""
MOST_WORKERS: Final = 10_000
"""No machine has as many processors, and no time is reckoned with more."""
_SLOW_TO_IMPORT: Final = ("cv2", "shapely", "benchmark.datasets.nuscenes")

_number = 0
_started = False
_worker_seconds = 0.0


class Executor(Protocol):
    """Where units of work run."""

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

        Args:
            function: Importable (a module-level function or a partial of one).
            items: Picklable arguments; they may be made lazily and are asked for a little ahead of the results.
            total: How many items there are.
            label: What is done, for people.
            count: What is counted of it; scenes by default.

        Yields:
            One result per item.

        Raises:
            InputError: If workers are lost for good.
        """


def single_threaded() -> None:
    """Make the numerical libraries of this process use one thread, regardless of environment variables."""
    import cv2
    import numpy as np  # noqa: F401 - limits hold for the libraries that are loaded by then
    from threadpoolctl import threadpool_limits

    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    else:
        # torch takes two seconds to import, which most planners do not need; it reads these if it is imported later.
        os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    cv2.setNumThreads(1)
    # numpy has no setting for it, and its products round differently with more threads.
    threadpool_limits(1, user_api="blas")


def default_workers() -> int:
    """Number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


@dataclass(frozen=True, slots=True)
class LocalProcesses:
    """This machine's processes; one worker computes in this process."""

    workers: int = 1

    def map(
        self,
        function: Callable[[Item], Result],
        items: Iterable[Item],
        *,
        total: int,
        label: str,
        count: CountedUnits | None = None,
    ) -> Iterator[Result]:
        """Apply a function to items and give the results in the order of the items."""
        if self.workers < 1:
            raise InputError(f"--workers must be at least 1, got {self.workers}")
        if self.workers == 1 or total < 2:
            single_threaded()
            return track_progress(map(function, items), total=total, label=label, count=count)
        return self._in_processes(function, items, total=total, label=label, count=count or CountedUnits())

    def _in_processes(
        self,
        function: Callable[[Item], Result],
        items: Iterable[Item],
        *,
        total: int,
        label: str,
        count: CountedUnits,
    ) -> Iterator[Result]:
        global _started
        workers, before = min(self.workers, total), set(multiprocessing.active_children())
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(_list_preloads(function))
        needs_script = _needs_script(function)
        begun, spent_s = context.Value("i", 0), context.Value("d", 0.0)
        _started = True
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker, initargs=(begun, spent_s))
        with _counted(spent_s), pool, PROGRESS_REPORTER.work(label, total, count) as work:
            try:

                def submit(item: Item) -> "Future[Result]":
                    with nullcontext() if needs_script else _without_main_script():
                        return report_when_done(pool.submit(function, item), work)

                yield from results_in_order(submit, items, workers)
            except BrokenProcessPool as error:
                guard = ', or where the script that workers take definitions from lacks `if __name__ == "__main__":`'
                raise InputError(
                    f"a worker process ended abruptly ({label}), as happens where memory runs out"
                    f"{guard if needs_script else ''}; run the same command again with fewer --workers (finished work "
                    "is kept)"
                ) from error
            except BaseException:
                # The other results are not needed, and a unit may take minutes: interrupted work is redone anyway.
                for worker in set(multiprocessing.active_children()) - before:
                    worker.terminate()
                raise


@contextmanager
def _counted(spent_s: "Synchronized[float]") -> Iterator[None]:
    """CPU seconds that workers note when they end are those of `processor_seconds`."""
    global _worker_seconds
    try:
        yield
    finally:
        _worker_seconds += spent_s.value


def processor_seconds() -> tuple[float, float]:
    """CPU seconds of this process, and of its workers and other processes that it has waited for."""
    return time.process_time(), sum(os.times()[2:4]) + _worker_seconds


def map_ordered(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int,
    label: str,
    count: CountedUnits | None = None,
) -> Iterator[Result]:
    """`LocalProcesses.map` for items that are all there already."""
    return LocalProcesses(workers).map(function, items, total=len(items), label=label, count=count)


def report_when_done(future: "Future[Result]", work: WorkProgress) -> "Future[Result]":
    """The same future; once it has a result, the progress is updated, in any order of results."""

    def finished(done: "Future[Result]") -> None:
        if not done.cancelled() and done.exception() is None:
            work.add(done.result())

    future.add_done_callback(finished)
    return future


def results_in_order(
    submit: Callable[[Item], "Future[Result]"], items: Iterable[Item], workers: int
) -> Iterator[Result]:
    """Keep workers busy and give their results in the order of the items; so is the first error.

    Items are drawn only while few submitted units are unfinished, or wait for the result of an earlier one.
    """
    remaining = iter(items)
    ordered: deque[Future[Result]] = deque()
    unfinished: set[Future[Result]] = set()
    exhausted = False
    while ordered or not exhausted:
        unfinished = {future for future in unfinished if not future.done()}
        room = len(unfinished) < UNFINISHED_PER_WORKER * workers and len(ordered) < WAITING_PER_WORKER * workers
        if room and not exhausted:
            try:
                ordered.append(submit(next(remaining)))
                unfinished.add(ordered[-1])
            except StopIteration:
                exhausted = True
        if ordered and ordered[0].done():
            yield ordered.popleft().result()
        elif exhausted or not room:
            wait(unfinished, return_when=FIRST_COMPLETED)


def _needs_script(function: Callable[..., Any]) -> bool:
    """Whether workers need what the script that runs defines, so that each has to run it, too."""
    try:
        return b"__main__" in pickle.dumps(function)
    except Exception:
        # Errors of pickling are reported where the function is sent.
        return True


@contextmanager
def _without_main_script() -> Iterator[None]:
    """Processes that begin in here do not run the script that this process runs, with or without a guard.

    Python's own way for notebooks and ``python -c``: a main module without a file is none to run.
    """
    script = vars(sys.modules["__main__"])
    hidden: dict[str, Any] = {name: script[name] for name in ("__file__", "__spec__") if name in script}
    script.pop("__file__", None)
    script["__spec__"] = None
    try:
        yield
    finally:
        script.update(hidden)


def _module_of(function: Callable[..., Any]) -> tuple[str, ...]:
    """Name of the module that a function comes from; none for a script, which each worker runs anew."""
    while isinstance(function, functools.partial):
        function = function.func
    module = getattr(function, "__module__", "__main__")
    return () if module == "__main__" else (module,)


def _list_preloads(function: Callable[..., Any]) -> list[str]:
    """Modules that the forkserver imports, so that workers need not."""
    module = _module_of(function)
    # The process is started once; work that builds data is followed by work that plans with a network.
    needs_torch = "torch" in sys.modules or any(name.partition(".")[0] == "generation" for name in module)
    return [*(["torch"] if needs_torch else []), *_SLOW_TO_IMPORT, *module]


def has_forkserver() -> bool:
    """Whether this process had workers before: what they are copied from is there, and the next ones begin at once."""
    return _started


def worker_number() -> int:
    """Number of this process among the workers of a command: 0, 1, ...; 0 where the command itself works."""
    return _number


def _begin_worker(begun: "Synchronized[int]", spent_s: "Synchronized[float]") -> None:
    global _number
    # Workers are the forkserver's children, so that the command itself is not told what they used.
    Finalize(None, _add_own_seconds, args=(spent_s,), exitpriority=0)
    # A terminal interrupts all processes of a command at once; the main process handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with begun.get_lock():
        _number = begun.value
        begun.value += 1
    PROGRESS_REPORTER.silence()
    collect_rarely()
    threading.Thread(target=end_with_parent, daemon=True).start()
    single_threaded()


def _add_own_seconds(spent_s: "Synchronized[float]") -> None:
    with spent_s.get_lock():
        spent_s.value += sum(os.times()[:4])


def end_with_parent() -> None:
    """End this process when its parent is gone, killed perhaps: no more work would come."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
