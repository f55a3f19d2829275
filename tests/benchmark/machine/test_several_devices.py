"""Several devices: one for each worker, in turns, and the same bytes as one."""

from dataclasses import replace
from pathlib import Path

import pytest

from adapters.registry import NamedPlanner, planner_factory
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine import workers
from benchmark.machine.several_devices import count_workers, find_own_device, parse_device_names, require_one_device
from generation.search.definition import PackagedPrior
from tests.benchmark.cli.cli_runs import bytes_below, refusal
from tests.benchmark.test_evaluation import town_of_six

PLACED = "tests.benchmark.planners:Placed"


def test_names_are_those_between_commas() -> None:
    assert parse_device_names("cuda:0, cuda:1") == ("cuda:0", "cuda:1") and parse_device_names("cpu") == ("cpu",)
    for text, why in (("cpu,", "empty"), (",", "empty"), ("", "empty"), ("cpu,cuda:0", "devices")):
        with pytest.raises(InputError, match=why):
            parse_device_names(text)


@pytest.mark.parametrize("number", range(5))
def test_workers_take_them_in_turns(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_number", number)
    assert find_own_device("cuda:0,cuda:1") == f"cuda:{number % 2}"
    assert find_own_device("cuda:3") == "cuda:3" and find_own_device(None) is None


def test_there_is_a_process_for_each() -> None:
    assert count_workers(0, "cuda:0,cuda:1,cuda:2") == 3 and count_workers(4, "cuda:0,cuda:1") == 4
    assert count_workers(0, "cuda") == 0 and count_workers(0, None) == 0 and count_workers(1, "cpu") == 1
    with pytest.raises(InputError, match="leaves some"):
        count_workers(1, "cuda:0,cuda:1")
    require_one_device("cuda:1", "why")
    with pytest.raises(InputError, match="why; use one device instead of --device cpu,cpu"):
        require_one_device("cpu,cpu", "why")


def test_a_factory_builds_on_the_device_of_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str | None] = []
    facts = planner_factory("constant-velocity").facts
    monkeypatch.setattr("adapters.registry.build_planner", lambda *_, device, **__: asked.append(device))
    factory = NamedPlanner("constant-velocity", None, 0, facts, "cuda:0,cuda:1")
    for number in range(3):
        monkeypatch.setattr(workers, "_number", number)
        factory()
    assert asked == ["cuda:0", "cuda:1", "cuda:0"]


def test_two_devices_give_the_bytes_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmark.evaluation.PROCESSES_PAY_AFTER_S", 0.0)
    one, two = (planner_factory(PLACED, device=device) for device in ("cpu", "cpu,cpu"))
    assert one.facts == two.facts and replace(one, device="cpu,cpu") == two
    for name, factory, count in (("one", one, 1), ("two", two, 2)):
        evaluate(town_of_six(), "val", factory, tmp_path / name, EvalSettings(workers=count), reopen=town_of_six)
    assert bytes_below(tmp_path / "one") == bytes_below(tmp_path / "two")


def test_the_trajectory_model_is_on_the_device_of_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(
        "generation.search.definition._load_prior", lambda weights, device, sampler: asked.append(device)
    )
    prior = PackagedPrior(device="cuda:0,cuda:1")
    for number in range(3):
        monkeypatch.setattr(workers, "_number", number)
        prior()
    assert asked == ["cuda:0", "cuda:1", "cuda:0"]


@pytest.mark.parametrize(
    ("options", "says_what"),
    [
        (["--device", "cpu,cuda"], "devices"),
        (
            ["--device", "cpu,cpu", "--executor", "ray", "--address", "127.0.0.1:1"],
            "a Ray cluster assigns GPUs to its tasks",
        ),
        (["--shard", "1/2", "--executor", "ray", "--address", "127.0.0.1:1"], "a Ray cluster distributes the work "),
        (["--shard", "1/2", "--surrogate", "idm"], "--surrogate evaluates all scenes together"),
    ],
)
def test_what_generate_cannot_do_is_one_sentence(options: list[str], says_what: str, tmp_path: Path) -> None:
    assert says_what in refusal("generate", "--out", tmp_path, *options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "says_what"),
    [
        (["--device", "quantum:0,quantum:1"], "unknown device 'quantum:0'"),
        (["--device", "cpu,cpu", "--workers", "1"], "leaves some"),
        (["--device", "cpu,cpu", "--shard", "1/2"], "one process"),
    ],
)
def test_what_cannot_be_is_one_sentence(options: list[str], says_what: str, tmp_path: Path) -> None:
    assert says_what in refusal("eval", "--model", "vad-mini", "--out", tmp_path, *options)
