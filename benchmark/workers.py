"""Work on many items with this machine's processes, in order, with a progress bar.

Results come in the order of the items whatever the number of workers; every process computes with one thread, so that
one worker and many give the same bytes.
"""

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Protocol, TypeVar

from benchmark.errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Where units of work run."""

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], *, total: int, label: str
    ) -> Iterator[Result]:
        """Apply a function to items and give the results in the order of the items.

        Args:
            function: Importable (a module-level function or a partial of one).
            items: Picklable arguments; they may be made lazily and are asked for a little ahead of the results.
            total: How many items there are.
            label: Text beside the progress bar.

        Yields:
            One result per item.

        Raises:
            InputError: If workers are lost for good.
        """


def single_threaded() -> None:
    """Make the numerical libraries of this process use one thread."""
    import cv2
    import torch

    torch.set_num_threads(1)
    cv2.setNumThreads(1)


def default_workers() -> int:
    """Number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


@dataclass(frozen=True, slots=True)
class LocalProcesses:
    """This machine's processes.

    Attributes:
        workers: How many; 1 computes in this process.
    """

    workers: int = 1

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], *, total: int, label: str
    ) -> Iterator[Result]:
        """See `Executor.map`."""
        return map_ordered(function, list(items), workers=self.workers, label=label)


def map_ordered(
    function: Callable[[Item], Result], items: Sequence[Item], *, workers: int, label: str
) -> Iterator[Result]:
    """Apply a function to items, in parallel, and give the results in the order of the items.

    Args:
        function: Importable (a module-level function or a partial of one).
        items: Picklable arguments.
        workers: Number of processes; 1 computes here.
        label: Text beside the progress bar, shown only on a terminal and only for lasting work.

    Yields:
        One result per item.

    Raises:
        InputError: If ``workers`` is not positive, or a worker process is killed.
    """
    if workers < 1:
        raise InputError(f"--workers must be at least 1, got {workers}")
    if workers == 1 or len(items) < 2:
        single_threaded()
        yield from progress(map(function, items), total=len(items), label=label)
        return
    context = multiprocessing.get_context("forkserver")
    # The server imports the slow libraries once; every worker is forked from it, still on one thread.
    context.set_forkserver_preload(["torch", "cv2", "shapely", "benchmark.datasets.nuscenes"])
    with ProcessPoolExecutor(min(workers, len(items)), mp_context=context, initializer=single_threaded) as pool:
        futures: list[Future[Result]] = [pool.submit(function, item) for item in items]
        try:
            yield from progress((future.result() for future in futures), total=len(items), label=label)
        except BrokenProcessPool as error:
            raise InputError(
                f"a worker process ended abruptly ({label}), as happens where memory runs out; run the same command "
                "again with fewer --workers (finished work is kept)"
            ) from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def progress(results: Iterable[Result], *, total: int, label: str) -> Iterator[Result]:
    """Pass results through and show a bar with the time left on stderr, if stderr is a terminal.

    Args:
        results: What is being computed.
        total: How many there will be.
        label: Text beside the bar.

    Yields:
        The results.
    """
    if not sys.stderr.isatty():
        yield from results
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total)
        for result in results:
            yield result
            bar.advance(task)
