"""The simulation of interval coverage: right where the answer is known, and it sees an interval that is too narrow."""

import numpy as np
import pytest

from bench.coverage import Difficulty, coverage_over_scenes, coverage_over_seeds
from benchmark.metrics import drawn_seeds


def test_scenes_are_drawn_with_the_rate_that_they_are_said_to_have() -> None:
    rng = np.random.default_rng(0)
    for each in (Difficulty("", 0.17, 0.3), Difficulty("", 0.01, 0.3, hard=0.1)):
        rates = each.drawn(rng, 200_000)
        assert rates.mean() == pytest.approx(each.rate, rel=0.05)
    assert (rates > 0).mean() == pytest.approx(0.1, rel=0.05)


def test_many_scenes_are_covered_as_promised_and_few_are_not() -> None:
    usual = Difficulty("", 0.17, 0.1)
    assert 0.9 <= coverage_over_scenes(usual, 60, 200) <= 1.0
    assert coverage_over_scenes(Difficulty("", 0.01, 0.3, hard=0.1), 5, 200) < 0.5


def test_seeds_say_what_they_are_about_and_not_more(monkeypatch: pytest.MonkeyPatch) -> None:
    found = coverage_over_seeds(Difficulty("", 0.1, 0.3), 0.1, 45, 5, 150)
    assert found.these > 0.88 and found.all_seeds > 0.85 and found.over_seeds < found.these
    # An interval with the wrong points is found out.
    monkeypatch.setattr(drawn_seeds, "student_975", lambda freedom: 0.5)
    assert coverage_over_seeds(Difficulty("", 0.1, 0.3), 0.1, 45, 5, 150).these < 0.6
