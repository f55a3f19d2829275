"""Work on a Ray cluster, and what is said where there is none."""

import contextlib
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from benchmark.errors import InputError
from benchmark.machine import ray_cluster
from benchmark.machine.ray_cluster import RayCluster
from tests.benchmark.machine import units_of_work

CASES = Path(__file__).with_name("ray_cluster_cases.py")


@pytest.mark.parametrize(
    "chosen", ["-k=test_results_are_those_of_local_processes", pytest.param("-k=test", marks=pytest.mark.slow)]
)
def test_the_cases_on_a_cluster(chosen: str) -> None:
    """In a process of their own, and once more if a signal ends it.

    Where a node is lost on a machine with many times more work than processors, Ray's library has been seen to crash
    the process that joined (a general protection fault in its input and output thread), which ended all tests of it.
    """
    pytest.importorskip("ray")
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", chosen, str(CASES)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode < 0:
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert " passed" in ended.stdout and "skipped" not in ended.stdout


def test_a_cluster_that_is_no_more_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "ray_current_cluster").write_text("127.0.0.1:1")
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    monkeypatch.setattr("ray.is_initialized", lambda: False)
    monkeypatch.setattr(ray_cluster, "ANSWER_S", 2.0)
    with pytest.raises(InputError, match=r"no Ray cluster answers at auto; start it with"):
        list(RayCluster("auto").map(units_of_work.doubled, [1], total=1, label="doubling"))


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"install challenger-bench\[ray\]"):
        list(RayCluster().map(units_of_work.doubled, [1], total=1, label="doubling"))


@pytest.mark.parametrize("address", ["", "head", "head:", ":6379", "head:0", "head:99999", "ray://"])
def test_an_address_that_is_none_is_a_sentence(address: str) -> None:
    with pytest.raises(InputError, match="the address of a Ray cluster is HOST:PORT"):
        ray_cluster.require_answer(address)


@pytest.mark.parametrize("answer", [b"HTTP/1.0 400 Bad Request\r\n\r\n", b"", None])
def test_where_no_cluster_answers_a_sentence_comes_at_once(
    answer: bytes | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another kind of server, one that hangs up, one that says nothing, and then none at all."""
    monkeypatch.setattr(ray_cluster, "ANSWER_S", 1.0)
    ended = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"

        def serve() -> None:
            while not ended.is_set():
                connection, _ = server.accept()
                with connection, contextlib.suppress(OSError):
                    if answer is None:
                        ended.wait(10.0)
                    else:
                        connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(InputError, match=r"no Ray cluster"):
            ray_cluster.require_answer(address)
        ended.set()
        # The server may be waiting for one more connection.
        socket.create_connection(server.getsockname()).close()
        thread.join()
    with pytest.raises(InputError, match=f"no Ray cluster answers at {address}"):
        ray_cluster.require_answer(address)
