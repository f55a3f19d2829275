"""One cluster of two nodes on this machine for all cases: starting one takes seconds. `test_ray_cluster` runs them."""

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.errors import InputError
from benchmark.machine import ray_cluster
from benchmark.machine.ray_cluster import RayCluster
from benchmark.machine.workers import LocalProcesses
from benchmark.runs.driving import DriveSettings, drive_split
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.machine import units_of_work
from tests.benchmark.planners import Factory, Remembering
from tests.benchmark.runs import test_encounters

# Ray leaves sockets and log files to the collector when its nodes are stopped.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    # Ray counts GPUs and never looks for them.
    node = {"num_cpus": 1, "num_gpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=node)
    yield cluster
    cluster.shutdown()


@pytest.fixture(scope="module")
def executor(cluster: Any) -> Iterator[RayCluster]:
    """Joined once for all tests: each stage of a command would join by itself."""
    import ray

    ray.init(cluster.address, log_to_driver=False)
    yield RayCluster(cluster.address)
    ray.shutdown()


def test_a_stage_joins_the_cluster_and_leaves_it(cluster: Any, capsys: pytest.CaptureFixture[str]) -> None:
    import ray

    executor = RayCluster(cluster.address)
    assert list(executor.map(units_of_work.doubled, [1, 2], total=2, label="doubling")) == [2, 4]
    assert not ray.is_initialized()
    with pytest.raises(InputError, match=r"a unit of work was lost on the Ray cluster \(counting; "):
        list(RayCluster(cluster.address, retries=1).map(units_of_work.killed, range(4), total=4, label="counting"))
    assert not ray.is_initialized()
    assert capsys.readouterr().out == ""


def test_a_unit_that_needs_a_gpu_sees_one(executor: RayCluster) -> None:
    of_gpus = replace(executor, gpus=1)
    assert list(of_gpus.map(units_of_work.gpus_in_sight, [0, 1], total=2, label="looking")) == ["0", "0"]
    with pytest.raises(InputError, match="has no GPUs to work on"):
        list(replace(executor, gpus=2).map(units_of_work.gpus_in_sight, [0], total=1, label="looking"))


def test_results_are_those_of_local_processes(executor: RayCluster) -> None:
    items, total = [*range(25)], 25
    doubled = list(executor.map(units_of_work.doubled, iter(items), total=total, label="doubling"))
    assert doubled == list(LocalProcesses(1).map(units_of_work.doubled, items, total=total, label="doubling"))
    assert list(executor.map(units_of_work.threads, [0], total=1, label="counting threads")) == [1]
    assert list(executor.map(units_of_work.doubled, [], total=0, label="nothing")) == []


def test_an_error_of_a_unit_is_raised_as_it_is_and_not_tried_again(executor: RayCluster) -> None:
    with pytest.raises(InputError) as caught:
        list(executor.map(units_of_work.refused, range(6), total=6, label="refusing"))
    assert type(caught.value) is InputError
    assert str(caught.value) == "item 2 is broken; leave it out"


def test_a_node_with_other_code_is_refused(executor: RayCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_cluster, "_code_fingerprint", lambda: "of another version")
    with pytest.raises(InputError, match="has another version of challenger-bench"):
        list(executor.map(units_of_work.doubled, [1], total=1, label="doubling"))


def test_nothing_is_lost_when_a_node_dies_half_way(cluster: Any, executor: RayCluster, tmp_path: Path) -> None:
    """Units that the dying node has begun are begun again elsewhere; the files are those of local processes."""
    here, there = tmp_path / "processes", tmp_path / "cluster"
    here.mkdir()
    there.mkdir()
    items = range(30)
    node = cluster.add_node(num_cpus=1, object_store_memory=80 * 2**20)
    traced = partial(units_of_work.traced_square, there, node.node_id, 8)
    results = executor.map(traced, items, total=30, label="squaring")
    given_back = [next(results) for _ in range(8)]
    deadline_s = time.perf_counter() + 60.0
    while not (running := units_of_work.begun_on(there, node.node_id, 8)):
        assert time.perf_counter() < deadline_s
        time.sleep(0.01)
    cluster.remove_node(node, allow_graceful=False)
    given_back += list(results)

    local = partial(units_of_work.kept_square, here, 0.0)
    assert given_back == list(LocalProcesses(1).map(local, items, total=30, label="squaring"))
    assert len(list(there.glob(f"begun-{running[0]}-*"))) == 2
    assert {path.name: path.read_bytes() for path in there.glob("*.json")} == {
        path.name: path.read_bytes() for path in here.glob("*.json")
    }


def test_drives_on_a_cluster_are_the_same_bytes(executor: RayCluster, tmp_path: Path) -> None:
    for name, where in (("here", LocalProcesses(1)), ("cluster", executor)):
        settings = DriveSettings("default", DefaultBackend("idm"), "idm", executor=where)
        drive_split(town_of_two(), "val", Factory(Remembering), tmp_path / name, settings, reopen=town_of_two)
        test_encounters.both(tmp_path / name, Factory(), test_encounters.two_variants, executor=where)
    assert bytes_below(tmp_path / "here") == bytes_below(tmp_path / "cluster")
