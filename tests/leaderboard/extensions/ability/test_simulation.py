"""Simulations of `bench.ability`: a newcomer's posterior, what is saved, and a file that is gone on with."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import ability
from bench.ability_next import GRID, Newcomer, summarise_newcomers
from leaderboard.extensions.ability.next_scenes import choose_next_scenes
from tests.leaderboard.extensions.ability.made_fits import gathered, made_fit

HOLES = [("stop", at) for at in range(8)]


def test_a_newcomer_is_weighed_as_draws_of_the_prior_are_by_what_it_did() -> None:
    fit = made_fit(gathered(holes=HOLES))
    newcomer = Newcomer(fit)
    assert newcomer.deviation == pytest.approx(1.0, abs=0.01)
    # Scenes 4 and 5 are of one recording, 0 is of another.
    outcomes = {4: 0.0, 5: 1.0, 0: 0.0}
    for scene, value in outcomes.items():
        newcomer.add(scene, value)
    rng, count = np.random.default_rng(0), 200_000
    at = rng.integers(0, len(fit.kept.theta), count)
    theta, sd_u = rng.standard_normal(count), np.array(fit.kept.sd_u)[at]
    shared, other = sd_u * rng.standard_normal((2, count))
    weight = np.ones(count)
    for scene, value in outcomes.items():
        ability_here = theta + (other if scene == 0 else shared)
        safe = 1.0 / (
            1.0 + np.exp(-np.exp(fit.draw("log_alpha")[at, scene]) * (ability_here - fit.draw("beta")[at, scene]))
        )
        weight *= safe if value else 1.0 - safe
    mean = np.average(theta, weights=weight)
    assert newcomer.weights.sum(axis=0) @ GRID == pytest.approx(mean, abs=0.01)
    assert newcomer.deviation == pytest.approx(np.sqrt(np.average((theta - mean) ** 2, weights=weight)), abs=0.01)


def test_what_is_chosen_is_what_the_product_chooses() -> None:
    fit = made_fit(gathered(holes=HOLES))
    newcomer = Newcomer(fit)
    first = newcomer.choose()
    # Nothing is known of it yet: it is an average planner.
    assert fit.scenes[first].scene in {each.scene for each in choose_next_scenes(fit, None, 2).scenes}
    newcomer.add(first, 1.0)
    second = newcomer.choose()
    assert fit.scenes[second].recording != fit.scenes[first].recording


def test_the_share_saved_is_of_random_scenes_that_give_the_same_deviation() -> None:
    shuffled = np.linspace(1.0, 0.3, 15).tolist()
    lines = [{"adaptive": [[0.9, 0.8, 0.75, 0.7, 0.61]], "random": [shuffled]}]
    # 0.61 after five scenes; the ninth random one is the first at or below it.
    assert summarise_newcomers(lines)["5"] == {"deviation": 0.61, "random": 9, "saved": 44}
    lines[0]["adaptive"][0][-1] = 0.2
    assert summarise_newcomers(lines)["5"]["saved"] is None


def test_a_second_call_goes_on_where_the_first_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[int] = []

    def run(given: Any, replicate: int, compiled: Any) -> dict[str, Any]:
        ran.append(replicate)
        if replicate == 2:
            return {"refused": "the chains did not agree"}
        names = ("theta", "contrast", "rank", "bootstrap rank", "width", "tau", "bootstrap tau", "bias", "rmse")
        return dict.fromkeys(names, 0.5 + replicate / 2) | {"called": 0.4, "wrong": 0.1, "r_hat": 1.0, "draws": 4000}

    monkeypatch.setattr(ability, "run_replicate", run)
    for count in (2, 3):
        arguments = ["ability", "--to", str(tmp_path / "lines"), "--replicates", str(count)]
        monkeypatch.setattr(sys, "argv", arguments)
        ability.main()
    assert ran == [0, 1, 2]
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (found["replicates"], found["agreed"], found["theta"], found["wrong of called"]) == (3, 2, 75.0, 25.0)
