"""A planner in a process of its own says what it says here, to the last bit, and nothing of it outlives who asks."""

import importlib
import os
import pickle
import select
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from adapters.registry import build_planner, planner_factory
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.metering import peak_memory_mb
from benchmark.planning import (
    CameraView,
    ContinuousPlanner,
    NoViews,
    Planner,
    PlannerLostError,
    PrivilegedPlanner,
    SupervisedPlanner,
)
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.plan_rows import BrokenImageError, plan_scene
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.sandbox import limits as libraries
from benchmark.sandbox.frames import MalformedError, QuestionChannel, encode_answer
from benchmark.sandbox.limits import SandboxLimits, seed_torch_on_import
from benchmark.sandbox.observation_packing import ObservationPacker, ObservationUnpacker
from benchmark.sandbox.planner import PlannerIdentity, PlannerSpec, SandboxedPlanner, make_sandboxed_planner
from benchmark.sandbox.shared_images import SharedImagePool, SharedImageReader
from generation.sources.rig import build_default_cameras
from tests.adapters.strangers import Good
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.sandbox.dying import Drawing
from tests.benchmark.sandbox.test_deaths import gone, maker, processes, roads, wait_until_gone

QUICK = SandboxLimits(60.0, loading_s=60.0)


class Picture:
    """Loads numbers that say which picture they are; a new one each time, as files do."""

    def __init__(self, number: int, *, writable: bool, broken: bool = False) -> None:
        self.number = number
        self.writable = writable
        self.broken = broken

    def __call__(self) -> Any:
        if self.broken:
            raise InputError("image CAM.jpg is missing")
        found = np.random.default_rng(self.number).integers(0, 255, (9, 16 + self.number, 3), np.uint8)
        found.flags.writeable = self.writable
        return found


def pictured(*, broken: bool = False) -> FakeData:
    views = {
        camera.name: CameraView(
            camera, Path(f"{camera.name}.jpg"), 5, np.eye(4), Picture(place, writable=place % 2 == 0, broken=broken)
        )
        for place, camera in enumerate(build_default_cameras())
    }
    return replace(town_of_two(), views=views)


def test_plans_are_the_same_bytes_as_in_this_process(tmp_path: Path) -> None:
    data, (made, identity) = pictured(), maker("Drawing")
    planners: dict[str, Planner] = {"here": Drawing(), "there": make_sandboxed_planner(made, identity, QUICK)}
    rows = {
        where: [plan_scene(each, data, name, tmp_path / where / name, name, fresh=False).rows for name in data.scenes]
        for where, each in planners.items()
    }
    assert rows["here"] == rows["there"]
    assert all(row["status"] == "ok" for scene in rows["there"] for row in scene)


def test_the_memory_that_counts_is_that_of_its_own_process(tmp_path: Path) -> None:
    made, identity = maker("Drawing")
    planner = make_sandboxed_planner(made, identity, QUICK)
    assert isinstance(planner, SupervisedPlanner) and planner.pid is None
    cost = plan_scene(planner, pictured(), "scene-9901", tmp_path / "a", "a", fresh=False).cost
    assert planner.pid is not None and planner.pid != os.getpid() and cost is not None
    own, here = peak_memory_mb(planner.pid), peak_memory_mb()
    assert own is not None and here is not None and cost.peak_memory_mb is not None
    assert 10.0 < cost.peak_memory_mb <= own and abs(cost.peak_memory_mb - here) > 1.0
    planner.close()
    assert planner.pid is None


def test_pictures_of_a_sample_that_is_over_are_refused(tmp_path: Path) -> None:
    """Here they can still be loaded; there nobody waits for that any more, and nothing is mistaken for an answer."""
    data, (made, identity) = pictured(), maker("LoadsElsewhere")
    rows = plan_scene(
        make_sandboxed_planner(made, identity, QUICK), data, "scene-9901", tmp_path / "a", "a", fresh=False
    ).rows
    first, *others = (row["plan"]["waypoints"][0][0] for row in rows)
    assert set(others) == {first + 6000.0}


def same(one: Any, other: Any) -> bool:
    """Equal in type and in every number, as deep as they are; functions are not looked at."""
    if callable(one):
        return callable(other)
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    if is_dataclass(one):
        return all(same(getattr(one, each.name), getattr(other, each.name)) for each in fields(one))
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    return bool(one == other)


def test_an_observation_arrives_as_it_was() -> None:
    packing, unpacking = ObservationPacker(), ObservationUnpacker()
    plain = [*pictured().observations("scene-9901")]
    odd = replace(plain[0], views={}, ego=replace(plain[0].ego, can_motion=np.arange(9.0), steering_angle=0.5))
    narrow = replace(plain[1], past_poses=plain[1].past_poses[:1], past_valid=plain[1].past_valid[:1])
    blind = replace(plain[0], views=NoViews())
    for each in (*plain[:2], odd, narrow, blind, plain[2]):
        sent = pickle.loads(pickle.dumps(packing.packed(each)))  # noqa: S301 - of the line before
        arrived = unpacking.unpack(sent, lambda name: np.zeros((1, 1, 3), np.uint8))
        assert same(each, arrived)
    assert not same(plain[0], plain[1])


def test_a_broken_picture_is_nobodys_failure(tmp_path: Path) -> None:
    made, identity = maker("Drawing")
    with pytest.raises(BrokenImageError, match=r"CAM\.jpg is missing"):
        plan_scene(
            make_sandboxed_planner(made, identity, QUICK),
            pictured(broken=True),
            "scene-9901",
            tmp_path / "a",
            "a",
            fresh=False,
        )
    assert not (tmp_path / "a").exists()


def test_pictures_share_memory_and_blocks_are_used_again() -> None:
    shelf = SharedImagePool()
    viewer = SharedImageReader(os.dup(shelf.file))
    first: NDArray[np.uint8] = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    place = shelf.put(first)
    seen = viewer.look(place, first.shape, writable=True)
    part = seen[1]
    assert (seen == first).all() and viewer.collect_released() == []
    seen[0] = 99
    assert (viewer.look(place, first.shape, writable=False) == first).all()
    viewer.collect_released()
    del seen
    # A view of it is held still.
    assert shelf.put(first[::-1]) != place and viewer.collect_released() == [] and (part == first[1]).all()
    del part
    assert viewer.collect_released() == [place]
    shelf.reclaim([place])
    assert shelf.put(first[::-1]) == place and (viewer.look(place, first.shape, writable=False) == first[::-1]).all()
    with pytest.raises(KeyError):
        shelf.reclaim([12345])
    assert shelf.beats() == 0
    viewer.beat()
    assert shelf.beats() == 1


def test_who_it_is_and_what_it_can_do_are_as_here() -> None:
    here = build_planner("tests.adapters.strangers:Good", seed=3)
    factory = planner_factory("tests.adapters.strangers:Good", seed=3)
    assert factory.facts == build_planner_facts(here, made_by="tests.adapters.strangers:Good")
    there = factory()
    assert isinstance(there, SupervisedPlanner) and there.name == here.name == "good"
    assert not isinstance(there, PrivilegedPlanner | ContinuousPlanner | Good)
    sees = planner_factory("adapters.planners.log_replay:LogReplay")
    assert sees.facts.privileged and isinstance(sees(), PrivilegedPlanner)


def test_a_planner_that_is_another_one_each_time_is_lost(tmp_path: Path) -> None:
    made, identity = maker("Drawing")
    other = replace(identity, facts=identity.facts.model_copy(update={"settings": {"a": 1}}))
    rows = plan_scene(
        make_sandboxed_planner(made, other, QUICK), town_of_two(), "scene-9901", tmp_path / "a", "a", fresh=False
    ).rows
    assert {row["error"] for row in rows} == {"it reports a different identity each time it is built"}


def test_no_plan_without_reset() -> None:
    made, identity = maker("Drawing")
    with pytest.raises(PlannerLostError, match="call reset"):
        make_sandboxed_planner(made, identity, QUICK).plan(next(town_of_two().observations("scene-9901")))


LOADING = """
import ctypes, os, sys, time
from benchmark.planning import Plan

class Straight:
    name = "straight"
    def reset(self, scene): pass
    def plan(self, observation): pass

class Hangs(Straight):
    def __init__(self): time.sleep(1000)

class Faults(Straight):
    def __init__(self): ctypes.string_at(0)

"""


@pytest.mark.parametrize(
    ("model", "says"),
    [
        ("at_home:Hangs", "importing and building it did not end within 2 s; its process was ended"),
        ("at_home:Faults", r"the planner's process died \(signal SIGSEGV\)"),
        ("leaving:Planner", "the planner's process ended by itself with exit status 0"),
    ],
)
def test_who_dies_when_it_is_loaded_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, model: str, says: str
) -> None:
    (tmp_path / "at_home.py").write_text(textwrap.dedent(LOADING))
    (tmp_path / "leaving.py").write_text("import os\nos._exit(0)\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    limits = SandboxLimits(1.0, loading_s=2.0 if model == "at_home:Hangs" else 60.0)
    with pytest.raises(InputError, match=f"model '{model}' cannot be loaded: {says}") as error:
        planner_factory(model, supervision=limits)
    assert "\n" not in str(error.value)
    assert model.partition(":")[0] not in sys.modules


class Odd(Good):
    def __init__(self, **attributes: Any) -> None:
        super().__init__()
        vars(self).update(attributes)


def nested(depth: int) -> list[Any]:
    return [] if depth == 0 else [nested(depth - 1)]


def endless() -> dict[str, Any]:
    found: dict[str, Any] = {}
    found["itself"] = found
    return found


@pytest.mark.parametrize(
    ("attributes", "says"),
    [
        ({"settings": 3}, "settings of planner 'good' must be plain JSON values"),
        ({"settings": {1: 2}}, "names must be text"),
        ({"settings": {"a": float("nan")}}, "plain JSON values"),
        ({"settings": {"a": object()}}, "plain JSON values"),
        ({"settings": {"a": "\ud800"}}, "plain JSON values"),
        ({"settings": endless()}, "plain JSON values"),
        ({"settings": {"a": nested(900)}}, "plain JSON values"),
        ({"settings": {"a": "long" * 100_000}}, "have 400008 characters"),
        ({"seed": "five"}, "seed of planner 'good' must be a whole number .* it is 'five'"),
        ({"seed": -1}, "must be a whole number"),
        ({"seed": float("nan")}, "must be a whole number"),
        ({"weights_sha256": object()}, "weights_sha256 of planner 'good' must be the SHA-256"),
        ({"weights_sha256": "abc"}, "64 hexadecimal digits"),
        ({"native_protocol": ["uniad"]}, "unknown native protocol"),
    ],
)
def test_odd_claims_are_one_sentence(attributes: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as error:
        build_planner_facts(Odd(**attributes))
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


def test_asking_may_raise_and_is_one_sentence() -> None:
    class Reluctant(Good):
        @property
        def settings(self) -> dict[str, Any]:
            raise RuntimeError("ask later")

    with pytest.raises(InputError, match="reading settings of planner 'good' raised RuntimeError: ask later"):
        build_planner_facts(Reluctant())


def test_limits_are_seconds_and_memory_of_this_world() -> None:
    assert SandboxLimits.of(None, None) == SandboxLimits() and SandboxLimits.of(2.0, 1.0).memory_bytes == 1 << 30
    assert SandboxLimits(1.0).longest_loading_s == 300.0 and SandboxLimits(100.0).longest_loading_s == 1000.0
    for wrong in (0.0, -1.0, float("nan"), float("inf"), 1e9):
        with pytest.raises(InputError, match="--sample-limit must be"):
            SandboxLimits.of(wrong, None)
        with pytest.raises(InputError, match="--memory-limit must be"):
            SandboxLimits.of(None, wrong)


def test_a_library_that_comes_late_is_seeded_then(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "made_up_torch.py").write_text(
        "said = []\ndef set_num_threads(count): said.append(count)\ndef manual_seed(seed): said.append(seed)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(libraries, "_TORCH", "made_up_torch")
    before = list(sys.meta_path)
    for seed in (5, 7):
        seed_torch_on_import(seed)
    late: Any = importlib.import_module("made_up_torch")
    assert late.said == [1, 7] and sys.meta_path == before
    seed_torch_on_import(9)
    assert sys.meta_path == before
    del sys.modules["made_up_torch"]


def test_one_worker_and_two_write_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("ordinary", "leaves-with-3", "prints", "z-ordinary")
    monkeypatch.setattr("benchmark.evaluation.PROCESSES_PAY_AFTER_S", -1.0)
    made, identity = maker("Dying", notes=tmp_path)
    factory = _Factory(made, identity)
    written = {}
    for workers in (1, 2):
        out = tmp_path / f"out-{workers}"
        record = evaluate(
            roads(*names), "val", factory, out, EvalSettings(("exact",), workers=workers), reopen=_Roads(names)
        )
        assert record.run.config["supervision"] == {"sample_limit_s": 60.0, "memory_limit_bytes": None}
        assert record.summary.failed == 3 and not record.complete
        written[workers] = {name: data for name, data in bytes_below(out).items() if "timing" not in name}
    assert written[1] == written[2]
    wait_until_gone(processes(tmp_path, "planner"))


@dataclass(frozen=True)
class _Factory:
    made: PlannerSpec
    identity: PlannerIdentity
    supervision: SandboxLimits = QUICK

    @property
    def facts(self) -> PlannerFacts:
        return self.identity.facts

    def __call__(self) -> SandboxedPlanner:
        return make_sandboxed_planner(self.made, self.identity, self.supervision)


class _Roads:
    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names

    def __call__(self) -> FakeData:
        return roads(*self._names)


KILLED = """
import os, sys, time
from pathlib import Path
from benchmark.planning import SceneInfo
from benchmark.sandbox.planner import make_sandboxed_planner
from tests.benchmark.sandbox.test_deaths import maker
from benchmark.sandbox.limits import SandboxLimits
made, identity = maker("Dying", notes=Path(sys.argv[1]))
planner = make_sandboxed_planner(made, identity, SandboxLimits())
planner.reset(SceneInfo("a", "", ()))
Path(sys.argv[1], f"asker-{os.getpid()}").touch()
if sys.argv[2] == "leaves":
    sys.exit()
time.sleep(1000)
"""


@pytest.mark.parametrize("how", ["killed", "leaves"])
def test_nothing_outlives_who_asks(tmp_path: Path, how: str) -> None:
    root = Path(__file__).resolve().parents[3]
    asker = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path), how], cwd=root)
    until = time.monotonic() + 60.0
    while not processes(tmp_path, "asker"):
        assert time.monotonic() < until and (asker.poll() is None or how == "leaves")
        time.sleep(0.05)
    (there,) = processes(tmp_path, "planner")
    if how == "killed":
        assert not gone(there)
        asker.send_signal(signal.SIGKILL)
    asker.wait(60)
    wait_until_gone([there])


def test_an_answer_may_come_in_pieces_and_with_the_next_one() -> None:
    asking, answering = socket.socketpair()
    with asking, answering:
        asker, until = QuestionChannel(asking), time.monotonic() + 20.0
        first, second = (encode_answer(number, ["plan", np.arange(count)]) for number, count in ((1, 3), (2, 60_000)))

        def dribbled() -> None:
            for end in range(len(first)):
                answering.sendall(first[end : end + 1])
            answering.sendall(second[:7])
            answering.sendall(second[7:])

        thread = threading.Thread(target=dribbled)
        thread.start()
        for number, count in ((1, 3), (2, 60_000)):
            assert asker.wait(select.POLLIN, until - time.monotonic())
            assert asker.receive(number, until)[1].tolist() == [*range(count)]
        thread.join()
        answering.sendall(encode_answer(3, []) + encode_answer(3, []))
        assert asker.wait(select.POLLIN, 1.0) and asker.receive(3, until) == []
        # What was said too much is there at the next question, and is no answer to that.
        assert asker.wait(select.POLLIN, 0.0)
        with pytest.raises(MalformedError, match="answered another question"):
            asker.receive(4, until)
