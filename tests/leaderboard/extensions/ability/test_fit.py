"""What a given posterior says: abilities, ranks, scenes, which scene is next; how it is stored; what pages show."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from leaderboard.extensions.ability.figures import ability_figures, compute_curve, find_telling_scenes
from leaderboard.extensions.ability.fit import (
    AbilityFit,
    StoredFit,
    find_fit_path,
    list_fits,
    read_fit,
    require_planner,
    write_fit,
)
from leaderboard.extensions.ability.next_scenes import choose_next_scenes, compute_information
from leaderboard.extensions.ability.posterior import rank_draws
from leaderboard.extensions.ability.tables import ability_table, build_sections, difficulty_table, list_statistics
from tests.leaderboard.extensions.ability.made_fits import ABILITIES, gathered, made_fit


def test_abilities_are_contrasts_and_who_ranks_nothing_has_no_rank() -> None:
    fit = made_fit()
    assert [each.name for each in fit.planners] == sorted(ABILITIES)
    assert sum(each.ability for each in fit.planners) == pytest.approx(0.0, abs=1e-4)
    by_name = {each.name: each for each in fit.planners}
    # One miniature alone has nobody to be ranked among.
    assert by_name["stop"].best is None and by_name["stop"].reference and by_name["mini"].best is None
    assert (by_name["good"].best, by_name["good"].worst, by_name["good"].letters) == (1, 1, "a")
    assert (by_name["fair"].best, by_name["fair"].worst, by_name["fair"].letters) == (2, 2, "b")
    assert by_name["good"].low < by_name["good"].ability < by_name["good"].high
    middle = [scene.difficulty for scene in fit.scenes]
    assert middle == sorted(middle, key=lambda value: value or 0.0)
    mean = float(np.mean(list(ABILITIES.values())))
    assert middle[0] == pytest.approx(-1.5 - mean, abs=0.1)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 6))
def test_ranks_of_draws_are_those_counted_one_by_one(seed: int, planners: int) -> None:
    draws = np.random.default_rng(seed).integers(0, 4, (41, planners)).astype(float)
    found = rank_draws(draws)
    ranks = np.array(
        [[1 + sum(b > a or (b == a and j < i) for j, b in enumerate(row)) for i, a in enumerate(row)] for row in draws]
    )
    ordered = np.sort(ranks, axis=0)
    # The smallest values that 2.5 % and 97.5 % of the draws do not exceed: of 41 draws the 2nd and the 40th.
    assert found.best == tuple(ordered[1]) and found.worst == tuple(ordered[39])
    assert np.allclose(found.mean, ranks.mean(axis=0)) and np.allclose(found.first, (ranks == 1).mean(axis=0))


def test_too_few_planners_for_parameters_of_scenes_leave_their_tally() -> None:
    # A score has five parameters a scene: four planners are too few, for contacts they are enough.
    assert made_fit(gathered("contact")).scenes[0].difficulty is not None
    fit = made_fit(gathered("score"))
    assert {scene.difficulty for scene in fit.scenes} == {None} and fit.scenes[0].ran == 4
    assert "planners fail" in fit.describe_scene(fit.scenes[0]) and "difficulty" not in fit.describe_scene(
        fit.scenes[0]
    )


def test_the_next_scene_is_the_most_informative_and_recordings_take_turns() -> None:
    holes = [("fair", at) for at in (0, 1, 3, 4, 5)]
    fit = made_fit(gathered(holes=holes))
    place = require_planner(fit, "fair")
    assert place is not None
    found = choose_next_scenes(fit, place, 3)
    names = [each.scene for each in found.scenes]
    # It ran a scene of recordings 1 and 3: those of 0 and 2 come first, one each, and only then another one.
    assert {each.recording for each in found.scenes[:2]} == {"recording-0", "recording-2"} and found.left == 5
    information = compute_information(fit, fit.draw("theta")[:, place])
    assert names[0] == f"scene-{max((0, 1, 4, 5), key=lambda at: information[at])}"
    deviations = [found.deviation, *(each.deviation for each in found.scenes)]
    assert all(later < earlier for earlier, later in pairwise(deviations))
    shared = float(np.mean(np.square(fit.kept.sd_u)))
    best = max(information[at] for at in (0, 1, 4, 5))
    assert deviations[1] ** -2 == pytest.approx(found.deviation**-2 + best / (1 + best * shared))
    assert found.loss == pytest.approx(found.deviation - deviations[-1])
    assert len(choose_next_scenes(fit, place, 99).scenes) == 5


def test_a_second_variant_tells_less_the_more_they_share() -> None:
    def second(sd_u: float) -> float:
        fit = made_fit(gathered(scenes=10, variants=10), sd_u=sd_u)
        found = choose_next_scenes(fit, None, 2)
        return found.scenes[0].deviation ** -2 - found.scenes[1].deviation ** -2

    gains = [-second(sd_u) for sd_u in (0.0, 0.5, 2.0)]
    assert gains[0] > gains[1] > gains[2] > 0.0


def test_without_a_record_it_is_for_an_average_planner_and_nothing_is_left_where_all_is_run() -> None:
    fit = made_fit()
    assert require_planner(fit, "newcomer") is None
    found = choose_next_scenes(fit, None, 4)
    assert found.left == 8 and found.deviation == pytest.approx(1.0, abs=0.1)
    assert len({each.recording for each in found.scenes}) == 4
    with pytest.raises(InputError, match="fair has an outcome in every one of the 8 scenes"):
        choose_next_scenes(fit, require_planner(fit, "fair"), 1)


def test_several_versions_of_a_name_are_not_guessed() -> None:
    fit = made_fit()
    two = [each.model_copy(update={"name": f"p (seed {at})"}) for at, each in enumerate(fit.planners[:2])]
    fit = fit.model_copy(update={"planners": [*two, *fit.planners[2:]]})
    assert require_planner(fit, "p (seed 1)") == 1
    with pytest.raises(InputError, match=r"several versions of p: p \(seed 0\), p \(seed 1\)"):
        require_planner(fit, "p")
    alone = fit.model_copy(update={"planners": [two[0], *fit.planners[2:]]})
    assert require_planner(alone, "p") == 0


@pytest.mark.parametrize("kind", ["contact", "score"])
def test_a_fit_reads_back_and_damage_is_one_sentence(kind: str, tmp_path: Path) -> None:
    fit = made_fit(gathered("score" if kind == "score" else "contact", holes=[("fair", 2)]))
    path = write_fit(tmp_path, fit)
    assert path == find_fit_path(tmp_path, fit.measured) and list_fits(tmp_path) == [fit] and read_fit(path) == fit
    first = path.read_bytes()
    write_fit(tmp_path, fit)
    assert path.read_bytes() == first
    stored: dict[str, Any] = json.loads(first)
    wrong: Any
    for wrong in (
        {**stored, "schema": 2},
        {**stored, "values": stored["values"][1:]},
        {**stored, "kept": {**stored["kept"], "beta": []}},
        {**stored, "r_hat": None},
        [],
    ):
        path.write_text(json.dumps(wrong))
        with pytest.raises(InputError, match=r"is no fit of abilities of this version .*; delete it"):
            read_fit(path)
    path.write_bytes(first[:-20])
    with pytest.raises(InputError, match="not valid JSON"):
        list_fits(tmp_path)


def sure(fit: AbilityFit, scene: int, value: float) -> AbilityFit:
    """The fit with one scene in which all planners do alike."""
    scenes = list(fit.scenes)
    scenes[scene] = scenes[scene].model_copy(update={"passed": scenes[scene].ran if value else 0})
    return fit.model_copy(update={"scenes": scenes})


def test_tables_count_what_tells_nothing_and_what_is_missing_and_drop_no_scene() -> None:
    fit = sure(sure(made_fit(gathered(holes=[("fair", 0), ("good", 0)])), 7, 0.0), 3, 1.0)
    table = ability_table(StoredFit(fit, current=False))
    notes = " ".join(table.notes)
    assert "2 of 32 cells (6 %) are missing; correlation with difficulty -" in notes
    assert "R-hat 1.003" in notes and "Fitted to other records" in table.notes[0] and "§ miniature" in notes
    nobody = sum(scene.passed == scene.ran for scene in fit.scenes)
    everybody = sum(scene.passed == 0 for scene in fit.scenes)
    assert f"Nobody fails {nobody} and everybody fails {everybody} of 8 scenes" in notes and nobody and everybody
    assert [row[0] for row in table.rows] == ["good", "fair", "mini §", "stop"]
    scenes = difficulty_table(fit)
    assert [row[2] for row in scenes.rows].count("fail") == everybody and len(scenes.rows) == 8
    assert scenes.rows[0][:3] == ("scene-7", "recording-3", "fail")
    assert "Fitted to" not in ability_table(StoredFit(fit, current=True)).notes[0]


def test_pages_and_statistics_show_scenes(tmp_path: Path) -> None:
    fit = made_fit()
    (section,) = build_sections([StoredFit(fit, current=True)])
    assert section.data_name == "d" and [figure.name.partition("-")[0] for figure in section.figures] == [
        "wright",
        "curves",
    ]
    facts = StoredFit(fit, current=False).list_scene_facts()
    term, words = facts["d", "adv", "scene-0"]
    assert term == "ability scale, contact, open loop (older records)" and words.startswith("difficulty -1.5")
    write_fit(tmp_path, fit)
    assert [table.name for table in list_statistics(tmp_path, {"d", "x"}, "adv")] == ["difficulty-adv-open-contact"]
    assert not list_statistics(tmp_path, {"d"}, "val") and not list_statistics(tmp_path, {"e"}, None)


def test_curves_rise_and_pictures_are_the_same_bytes_each_time() -> None:
    fit = made_fit()
    grid = np.linspace(-3, 3, 7)
    for scene in find_telling_scenes(fit):
        curve = compute_curve(fit, scene, grid)
        assert (np.diff(curve) > 0.0).all() and curve[0] > 0.0 and curve[-1] < 1.0
    # The middle ones tell most of planners in the middle.
    assert set(find_telling_scenes(fit, 2)) <= {1, 2, 3, 4, 5}
    first, again = ability_figures(fit), ability_figures(fit)
    assert [replace(each) for each in first] == again and first[0].dark() != first[0].svg
    assert len(ability_figures(made_fit(gathered("score")))) == 1
