"""A planner that is served and dies."""

from pathlib import Path

import pytest

from benchmark import api
from benchmark.extensions.http.session import PlannerSession, PlanRequestError
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.test_supervised_planners import MORTAL


def test_a_served_planner_that_dies_is_an_answer_and_the_next_reset_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mortal_planner.py").write_text(MORTAL)
    monkeypatch.syspath_prepend(str(tmp_path))
    planner = api.load_planner("mortal_planner:Mortal")()
    session = PlannerSession(planner)
    assert session.reset() == b"true"
    planner.close()  # type: ignore[attr-defined]
    with pytest.raises(PlanRequestError):
        session.infer(b"{}")
    assert session.reset() == b"true"
    planner.close()  # type: ignore[attr-defined]


def test_limits_are_of_planners_of_other_packages() -> None:
    assert "--sample-limit is of planners" in refusal("serve", "--model", "stop", "--sample-limit", "5")
