"""Versions of one planner in one table: told apart where something tells them apart, and only there."""

from pathlib import Path
from typing import Any

import pytest

from benchmark.errors import InputError
from benchmark.records.planner_versions import PLANS_SHA256, label_versions
from benchmark.records.run import RunRecord
from leaderboard.results import select_runs
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made


def version(split: str = "adv", **facts: Any) -> RunRecord:
    made = hand_made("driver", {"a": [HIT], "b": [CLEAN]}, split=split)
    planner = made.run.planner.model_copy(update=facts)
    return RunRecord(Path(str(facts)), made.run.model_copy(update={"planner": planner}), made.rows, made.summary)


def test_a_single_version_keeps_its_name() -> None:
    assert [found.planner for found in label_versions([version("val"), version("adv")])] == [version().planner] * 2


@pytest.mark.parametrize(
    ("facts", "labels"),
    [
        (
            [{"weights_sha256": "3fa2b1c0" * 8}, {"weights_sha256": "0" * 64}, {}],
            ["weights 3fa2b1c0", "weights 00000000", "weights none"],
        ),
        (
            [{"weights_sha256": a * 64, "settings": {"checkpoint": f"{a}.pth", "checkpoint_sha256": a}} for a in "ab"],
            ["weights aaaaaaaa", "weights bbbbbbbb"],
        ),
        ([{"settings": {"shared_code_sha256": sha}} for sha in "ab"], [None, None]),
        ([{"settings": {"gap": gap, "same": 2}} for gap in (1.0, 1.5)], ["gap 1.0", "gap 1.5"]),
    ],
)
def test_versions_are_told_apart_by_what_differs(facts: list[dict[str, Any]], labels: list[str | None]) -> None:
    found = [each.label for each in label_versions([version(**each) for each in facts])]
    assert found == [label and f"driver ({label})" for label in labels]


def test_versions_have_the_same_names_on_every_split() -> None:
    runs = [version("val", seed=1), version("adv", seed=1), version("adv", seed=2)]
    found = [each.planner for each in label_versions(runs)]
    assert found == ["driver (seed 1)", "driver (seed 1)", "driver (seed 2)"]


def test_a_plan_file_for_each_split_is_one_planner() -> None:
    val, adv, other = (
        version(split, settings={PLANS_SHA256: digit * 64})
        for split, digit in (("val", "1"), ("adv", "2"), ("adv", "3"))
    )
    name = val.planner
    assert [found.planner for found in label_versions([val, adv])] == [name, name]
    assert [found.planner for found in label_versions([val, adv, other])] == [
        f"{name} (plans_sha256 {digit * 8})" for digit in "123"
    ]


def test_a_leaderboard_holds_both_versions_but_not_one_version_twice() -> None:
    assert len(select_runs([version(seed=1), version(seed=2)])) == 2
    with pytest.raises(InputError, match="both hold"):
        select_runs([version(seed=1), version(seed=1, code_sha256="another commit")])
