import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.machine.workers import (
    UNFINISHED_PER_WORKER,
    WAITING_PER_WORKER,
    LocalProcesses,
    map_ordered,
    processor_seconds,
    results_in_order,
)
from tests.benchmark.machine import units_of_work

ROOT = Path(__file__).resolve().parents[3]


def done(result: int) -> "Future[int]":
    future = Future[int]()
    future.set_result(result)
    return future


def counted(items: range, drawn: list[int]) -> Iterator[int]:
    for item in items:
        drawn.append(item)
        yield item


@given(st.lists(st.integers(), max_size=30), st.integers(1, 4))
def test_results_come_in_the_order_of_the_items(items: list[int], workers: int) -> None:
    assert list(results_in_order(done, items, workers)) == items


def test_items_are_drawn_a_little_ahead_of_unfinished_work() -> None:
    drawn: list[int] = []
    pending = [Future[int]() for _ in range(1000)]
    results = results_in_order(lambda item: pending[item], counted(range(1000), drawn), 2)
    pending[0].set_result(7)
    assert next(results) == 7
    pending[1].set_result(8)
    assert next(results) == 8
    assert len(drawn) <= 2 * UNFINISHED_PER_WORKER + 2


def test_one_slow_unit_does_not_stop_the_others_but_bounds_the_waiting_results() -> None:
    drawn: list[int] = []
    slow, most = Future[int](), 2 * WAITING_PER_WORKER

    def submit(item: int) -> "Future[int]":
        if item == most - 1:
            slow.set_result(0)
        return slow if item == 0 else done(item)

    results = results_in_order(submit, counted(range(1000), drawn), 2)
    assert next(results) == 0
    assert len(drawn) == most
    assert list(results) == list(range(1, 1000))


def test_the_first_error_in_the_order_of_the_items_is_raised() -> None:
    failures = {3: InputError("three"), 5: InputError("five")}

    def submit(item: int) -> "Future[int]":
        future = Future[int]()
        if item in failures:
            future.set_exception(failures[item])
        else:
            future.set_result(item)
        return future

    given_back = []
    with pytest.raises(InputError, match="three"):
        for result in results_in_order(submit, range(9), 3):
            given_back.append(result)
    assert given_back == [0, 1, 2]


@pytest.mark.parametrize("workers", [1, 2])
def test_processes_give_what_one_process_gives(workers: int) -> None:
    executor = LocalProcesses(workers)
    assert list(executor.map(units_of_work.doubled, iter(range(20)), total=20, label="doubling")) == [*range(0, 40, 2)]
    assert list(executor.map(units_of_work.threads, [0, 0], total=2, label="counting threads")) == [1, 1]
    with pytest.raises(InputError, match="item 2 is broken"):
        list(executor.map(units_of_work.refused, range(50), total=50, label="refusing"))
    assert list(executor.map(units_of_work.doubled, [], total=0, label="nothing")) == []


PRODUCTS = """
import hashlib
import numpy
from benchmark.machine.workers import single_threaded
single_threaded()
chance = numpy.random.default_rng(0)
for rows, inner, columns in ((96, 96, 256), (97, 17, 512), (100, 100, 100), (500, 500, 500)):
    product = chance.standard_normal((rows, inner)) @ chance.standard_normal((inner, columns))
    print(hashlib.sha256(product.tobytes()).hexdigest())
"""


def test_products_of_matrices_are_the_same_whatever_the_environment_says_of_threads() -> None:
    said = set()
    for threads in ("1", "4"):
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": threads}
        said.add(subprocess.check_output([sys.executable, "-c", PRODUCTS], cwd=ROOT, env=environment, text=True))
    assert len(said) == 1


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_are_numbered_from_zero(workers: int) -> None:
    found = LocalProcesses(workers).map(units_of_work.number_of_worker, range(12), total=12, label="numbering")
    assert set(found) <= set(range(workers))
    assert units_of_work.number_of_worker(0) == 0


def test_what_workers_use_is_counted() -> None:
    _, before = processor_seconds()
    spent = sum(LocalProcesses(2).map(units_of_work.busy, [0.3, 0.3], total=2, label="busy"))
    tick = 1 / os.sysconf("SC_CLK_TCK")
    assert 0.6 <= spent <= processor_seconds()[1] - before + tick


def test_a_killed_worker_is_a_sentence() -> None:
    with pytest.raises(InputError, match=r"a worker process ended abruptly \(counting\)"):
        list(map_ordered(units_of_work.killed, [1, 2, 3], workers=2, label="counting"))


def test_an_error_of_the_items_ends_the_work() -> None:
    def items() -> Iterator[int]:
        yield from range(5)
        raise InputError("scene 5 is broken")

    started_s = time.perf_counter()
    with pytest.raises(InputError, match="scene 5 is broken"):
        list(LocalProcesses(2).map(units_of_work.long, items(), total=9, label="sleeping"))
    assert time.perf_counter() - started_s < 30.0


def test_units_of_a_killed_command_are_found_by_the_next(tmp_path: Path) -> None:
    unit = partial(units_of_work.kept_square, tmp_path, 0.0)
    first = LocalProcesses(2).map(unit, range(12), total=12, label="squaring")
    assert [next(first) for _ in range(3)] == [0, 1, 4]
    del first
    assert list(LocalProcesses(1).map(unit, range(12), total=12, label="squaring")) == [x * x for x in range(12)]
    assert len(list(tmp_path.glob("*.json"))) == 12


SLEEPING = """
import sys
from benchmark.machine.workers import LocalProcesses
from tests.benchmark.machine import units_of_work
if __name__ == "__main__":
    try:
        list(LocalProcesses(2).map(units_of_work.announced, [sys.argv[1]] * 2, total=2, label="sleeping"))
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 130), (signal.SIGKILL, -9), pytest.param(signal.SIGTERM, -15, marks=pytest.mark.slow)],
)
def test_workers_never_outlive_their_command(tmp_path: Path, number: int, code: int) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = subprocess.Popen(
        [sys.executable, "-c", SLEEPING, str(tmp_path)],
        cwd=ROOT,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Tests that run in the background of a shell ignore interrupts, and so would the command.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline_s = time.perf_counter() + 60.0
    while len(workers := list(tmp_path.iterdir())) < 2:
        assert command.poll() is None
        assert time.perf_counter() < deadline_s
        time.sleep(0.05)
    # As a terminal does it: an interrupt reaches every process of the command.
    (os.killpg if number == signal.SIGINT else os.kill)(command.pid, number)
    _, said = command.communicate(timeout=30.0)
    assert command.returncode == code
    assert "Traceback" not in said
    while any(Path(f"/proc/{worker.name}").exists() for worker in workers):
        assert time.perf_counter() < deadline_s
        time.sleep(0.05)


WITHOUT_GUARD = """
from benchmark.machine.workers import map_ordered
from tests.benchmark.machine.units_of_work import doubled

print("once", list(map_ordered(doubled, range(4), workers=2, label="test")))
"""
WITH_GUARD = """
from benchmark.machine.workers import map_ordered

def tripled(item):
    return 3 * item

if __name__ == "__main__":
    print("once", list(map_ordered(tripled, range(4), workers=2, label="test")))
"""


def run_script(text: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "script.py").write_text(text)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "script.py"], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_a_script_without_a_guard_runs_once_and_its_workers_do_not_run_it_again(tmp_path: Path) -> None:
    done = run_script(WITHOUT_GUARD, tmp_path)
    assert (done.returncode, done.stdout) == (0, "once [0, 2, 4, 6]\n"), done.stderr


def test_workers_know_what_a_guarded_script_defines(tmp_path: Path) -> None:
    done = run_script(WITH_GUARD, tmp_path)
    assert (done.returncode, done.stdout) == (0, "once [0, 3, 6, 9]\n"), done.stderr


def test_a_script_whose_definitions_workers_need_is_told_of_the_guard(tmp_path: Path) -> None:
    done = run_script(WITH_GUARD.replace('if __name__ == "__main__":', "if True:"), tmp_path)
    assert done.returncode != 0 and '`if __name__ == "__main__":`' in done.stderr
