"""Planners by name: found, built, checked, and told apart."""

import pickle
from pathlib import Path

import pytest

from adapters.models import baselines
from adapters.registry import build_planner, planner_factory
from benchmark.errors import InputError
from benchmark.planning import PrivilegedPlanner

HERE = "tests.adapters.strangers"


def test_every_built_in_planner_is_built_under_its_own_name() -> None:
    for name in baselines():
        assert build_planner(name).name == name
    privileged = {name for name in baselines() if isinstance(build_planner(name), PrivilegedPlanner)}
    assert privileged == {*("log-replay", "idm", "constant-velocity-on-path", "noisy-log", "noisy-log-published")}


def test_a_strangers_class_gets_the_arguments_it_takes(tmp_path: Path) -> None:
    weights = tmp_path / "weights.bin"
    weights.write_bytes(b"1")
    built = build_planner(f"{HERE}:Good", checkpoint=weights, seed=5)
    assert built.seed == 5 and built.checkpoint == weights  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nonsense", r"unknown model 'nonsense'; use constant-velocity, log-replay, idm, ego-status"),
        (f"{HERE}:Missing", "has no 'Missing'"),
        ("no.such.module:Class", "cannot import no.such.module"),
        (":Class", "not of the form"),
        (f"{HERE}:", "has no ''"),
        (f"{HERE}:NoReset", "no method reset"),
        (f"{HERE}:NoName", "has no name"),
        (f"{HERE}:NeedsMore", "needs arguments without defaults: device"),
        (f"{HERE}:NOT_CALLABLE", "is a int, not a class"),
    ],
)
def test_what_is_no_planner_is_one_sentence(name: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        build_planner(name)


def test_checkpoints_must_exist_and_be_wanted(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no checkpoint"):
        build_planner("ego-status", checkpoint=tmp_path / "none.safetensors")
    (tmp_path / "some").write_bytes(b"x")
    with pytest.raises(InputError, match="does not take --checkpoint"):
        build_planner("idm", checkpoint=tmp_path / "some")
    with pytest.raises(InputError, match="cannot read the weights of ego-status"):
        build_planner("ego-status", checkpoint=tmp_path / "some")


def test_a_factory_travels_and_knows_what_it_builds(tmp_path: Path) -> None:
    factory = pickle.loads(pickle.dumps(planner_factory("ego-status")))  # noqa: S301
    assert factory().name == "ego-status" and len(factory.facts.weights_sha256) == 64
    weights = tmp_path / "weights.bin"
    weights.write_bytes(b"1")
    one = planner_factory(f"{HERE}:Good", checkpoint=weights)
    weights.write_bytes(b"2")
    two = planner_factory(f"{HERE}:Good", checkpoint=weights)
    assert one.facts.settings["checkpoint_sha256"] != two.facts.settings["checkpoint_sha256"]
    assert one.facts.settings["checkpoint"] == "weights.bin"
    facts = planner_factory(f"{HERE}:Good", seed=7).facts
    assert facts.seed == 7 and facts.published_as is None and not facts.miniature
