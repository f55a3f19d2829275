"""Entries ranked: what counts, what refused scenes cost, and what is not told apart."""

import json
from pathlib import Path

import numpy as np
import pytest

from adapters.registry import planner_factory
from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scene_assessments import ASSESSMENTS_FILE, format_assessments
from benchmark.errors import InputError
from benchmark.extensions.challenge.checking import check_entry
from benchmark.extensions.challenge.cli import name_entries
from benchmark.extensions.challenge.entries import SPLIT, CheckedEntry
from benchmark.extensions.challenge.rules import ChallengeRules
from benchmark.extensions.challenge.scoring import ScoreSettings, score_entries
from benchmark.metrics.challenge_entries import (
    RefusedScene,
    average_planners,
    compare_entries,
    rank_entries,
    sum_adversary_contacts,
    sum_collisions,
)
from benchmark.metrics.rates import SceneSums
from benchmark.records.challenge import ChallengeScores, EntryScore, find_scores, read_scores, write_scores
from benchmark.records.run import find_records
from leaderboard.build import build_leaderboard_files
from leaderboard.extensions.challenge.tables import challenge_tables
from leaderboard.frame.results import read_results
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.challenge.small_entries import LEADER, RECORDINGS, Forged, cut_in, recording, write
from tests.benchmark.metrics.test_effect import ran

HASTY, STEADY = "tests.benchmark.extensions.challenge.hasty:Hasty", "tests.benchmark.extensions.challenge.hasty:Steady"


def slight(root: Path) -> DataSet:
    """An entry whose vehicle comes over by half a metre: nobody is bothered."""
    scenes = [recording(name, ahead_m=2.0 * at) for at, name in enumerate(RECORDINGS)]
    return write(root, "adv", [(cut_in(scene, aside_m=0.5), f"{scene.name}-s") for scene in scenes])


def half_forged(entry: Path, root: Path) -> DataSet:
    forged = Forged.copy(entry, root)
    forged.annotations(
        lambda _, row: row["translation"].__setitem__(0, row["translation"][0] + 0.05), LEADER, "scene-9902-a"
    )
    return open_data(root)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scores")


@pytest.fixture(scope="module")
def scores(entry: Path, base: DataSet, folder: Path) -> ChallengeScores:
    half = half_forged(entry, folder / "half")
    entries = {"slight": slight(folder / "slight"), "half": half, "cut-in": open_data(entry)}
    planners = [planner_factory(name) for name in (HASTY, STEADY)]
    found = score_entries(entries, base, planners, ScoreSettings(folder / "out"))
    assert read_scores(write_scores(folder / "out", found)) == found
    return found


def named(scores: ChallengeScores, name: str) -> EntryScore:
    return next(entry for entry in scores.entries if entry.entry.name == name)


def test_entries_rank_by_the_mean_of_their_planners(scores: ChallengeScores) -> None:
    assert [entry.entry.name for entry in scores.entries] == ["cut-in", "half", "slight"]
    best = scores.entries[0]
    assert scores.ranks == "adversary"
    rates = [best.planners[name].adversary.value for name in ("hasty", "steady")]
    assert rates[0] is not None and rates[0] > 0.1 and rates[1] == 0.0
    assert best.adversary.value == pytest.approx(rates[0] / 2)
    assert scores.entries[2].adversary.value == 0.0
    # 13 by nuPlan's rule.
    assert best.attributable.value == pytest.approx(6 / 40)
    assert best.careful_survives.value == 1.0 and best.careful_survives.denominator == 2
    assert best.least_gap_m.value is not None and best.delta_v_m_s.value is not None
    assert best.not_compared is not None and best.realism.value is None


def test_a_refused_scene_counts_as_one_on_which_nobody_collides(scores: ChallengeScores, folder: Path) -> None:
    whole, half = named(scores, "cut-in"), named(scores, "half")
    assert half.refused == ("scene-9902-a",) and not whole.refused
    assert half.planners["hasty"].collision.denominator == whole.planners["hasty"].collision.denominator == 20
    (record,) = [each for each in find_records(folder / "out" / "cut-in" / "runs") if each.planner == "hasty"]
    collisions = record.summary.protocols["exact"].columns["collision"]["avg"]
    assert whole.planners["hasty"].collision.value == pytest.approx(collisions.value)
    (first,) = [each for each in find_records(folder / "out" / "half" / "runs") if each.planner == "hasty"]
    of_first = first.summary.protocols["exact"].columns["collision"]["avg"]
    assert half.planners["hasty"].collision.value == pytest.approx((of_first.value or 0.0) / 2)


def test_scores_are_the_same_again(scores: ChallengeScores, entry: Path, base: DataSet, folder: Path) -> None:
    entries = {"half": open_data(folder / "half"), "cut-in": open_data(entry), "slight": open_data(folder / "slight")}
    planners = [planner_factory(name) for name in (HASTY, STEADY)]
    assert score_entries(entries, base, planners, ScoreSettings(folder / "out")) == scores


def test_the_leaderboard_shows_them(scores: ChallengeScores) -> None:
    files = build_leaderboard_files(read_results([], challenges=[scores]))
    page = files["README.md"].decode()
    assert "base: challenge challenge" in page and "| 1" in page and "cut-in" in page
    assert b"challenge-planners-challenge" in files["tables/challenge.csv"]
    ranking, planners, pairs = challenge_tables(scores)
    assert [row[1] for row in ranking.rows] == ["cut-in", "half", "slight"]
    assert len(planners.rows) == 6 and len(pairs.rows) == 3


def test_what_an_entry_says_of_itself_is_not_read(entry: Path, base: DataSet, tmp_path: Path) -> None:
    forged = Forged.copy(entry, tmp_path / "entry")
    data = open_data(forged.root)
    verdict = check_entry(data, base, ChallengeRules())
    honest = CheckedEntry.of(data, "honest", tmp_path / "place", verdict)
    liar = {
        name: tuple(each.model_copy(update={"category": "human.pedestrian.adult"}) for each in said)
        for name, said in honest.judgements.items()
    }
    (forged.folder / ASSESSMENTS_FILE).write_text(format_assessments(liar))
    rejected = {"verdict": "rejected", "reason": "too hard", "token": forged.scene()["token"]}
    review = {"format": "challenger-bench review", "schema": 1, "verdicts": {"scene-9901-a": rejected}}
    (forged.root / "review.json").write_text(json.dumps(review))
    again = open_data(forged.root)
    assert again.scene_names("adv") == ("scene-9902-a",)
    checked = CheckedEntry.of(again, "honest", tmp_path / "place", check_entry(again, base, ChallengeRules()))
    assert checked.scene_names(SPLIT) == ("scene-9901-a", "scene-9902-a")
    assert checked.judgements == honest.judgements
    facts = checked.scene_facts(checked.scene_names())
    assert all(fact.judgement is not None and fact.judgement.survives["cc"] for fact in facts.values())


def test_an_entry_without_an_accepted_scene_is_not_ranked(entry: Path, base: DataSet, tmp_path: Path) -> None:
    rules = ChallengeRules.model_validate({"gaps": {"ego_m": 100.0}})
    settings = ScoreSettings(tmp_path, rules)
    found = score_entries({"far": open_data(entry)}, base, [planner_factory(STEADY)], settings)
    (score,) = found.entries
    assert score.best_place is None and len(score.refused) == 2
    assert "has no accepted scenes" in challenge_tables(found)[0].plain()


def test_who_is_changed_is_the_adversary_even_if_the_entry_names_nobody(
    scores: ChallengeScores, entry: Path, base: DataSet, tmp_path: Path
) -> None:
    silent = Forged.copy(entry, tmp_path / "entry")
    path = silent.folder / "challenger.json"
    said = json.loads(path.read_text())
    for made in said["scenes"].values():
        made["adversaries"] = []
    path.write_text(json.dumps(said))
    planners = [planner_factory(HASTY)]
    (found,) = score_entries({"silent": open_data(silent.root)}, base, planners, ScoreSettings(tmp_path)).entries
    assert found.planners["hasty"] == named(scores, "cut-in").planners["hasty"]
    assert found.attributable.value is not None and found.attributable.value > 0.0


def test_under_another_protocol_its_collision_rate_ranks(entry: Path, base: DataSet, tmp_path: Path) -> None:
    settings = ScoreSettings(tmp_path, protocol="uniad")
    found = score_entries({"cut-in": open_data(entry)}, base, [planner_factory(HASTY)], settings)
    assert found.ranks == "collision" and found.entries[0].adversary.value
    ranking = challenge_tables(found)[0]
    assert ranking.columns[4:8] == ("collision rate (%)", "95 %", "adversary (%)", "95 %")


@pytest.mark.path
def test_contacts_with_bystanders_are_in_another_column() -> None:
    record = ran({"A-1": "fF..", "B-1": "F..."})
    refused = (RefusedScene("B", 4),)
    first, any_contact = sum_adversary_contacts(record, "3s", refused), sum_collisions(record, "exact", "3s", refused)
    assert first.names == any_contact.names == ("A", "B")
    assert first.numerators.tolist() == [[1.0], [0.0]] and any_contact.numerators.tolist() == [[2.0], [1.0]]
    assert first.denominators.tolist() == any_contact.denominators.tolist() == [[4.0], [8.0]]


def test_older_scores_rank_by_any_contact_and_have_dashes(scores: ChallengeScores, tmp_path: Path) -> None:
    old = scores.model_dump(mode="json", by_alias=True)
    del old["ranks"]
    for each in (*old["entries"], *(one for entry in old["entries"] for one in entry["planners"].values())):
        del each["adversary"]
    (tmp_path / "scores-old.json").write_text(json.dumps(old))
    (found,) = find_scores(tmp_path)
    assert found.ranks == "collision" and found.entries[0].adversary.value is None
    ranking, planners, _ = challenge_tables(found)
    for table, at in ((ranking, 4), (planners, 2)):
        assert table.columns[at : at + 3] == ("collision rate (%)", "95 %", "adversary (%)")
        assert {row[at + 2] for row in table.rows} == {"–"} and "–" not in {row[at] for row in table.rows}


def sums(rates: dict[str, float], samples: int = 10) -> SceneSums:
    values = np.array([[rate * samples] for rate in rates.values()])
    return SceneSums(tuple(rates), values, np.full_like(values, samples))


@pytest.mark.path
def test_places_are_told_apart_only_where_recordings_agree() -> None:
    names = [f"r{number:02d}" for number in range(30)]
    draw = np.random.default_rng(0)
    high = sums({name: 0.6 + 0.02 * draw.random() for name in names})
    low = sums({name: 0.2 + 0.02 * draw.random() for name in names})
    near = sums({name: 0.6 + 0.02 * draw.random() for name in names})
    entries = []
    for name, each in (("high", high), ("near", near), ("low", low)):
        measured, drawn = average_planners([each], names, 0)
        assert measured.value is not None and measured.low is not None and measured.high is not None
        assert measured.low <= measured.value <= measured.high
        entries.append((name, measured.value, drawn))
    pairs = compare_entries(entries, enough=True)
    assert [pair.told_apart for pair in pairs] == [False, True, True]
    assert rank_entries(["high", "near", "low"], pairs) == {"high": (1, 2), "near": (1, 2), "low": (3, 3)}


@pytest.mark.path
def test_of_one_recording_nothing_is_told_apart() -> None:
    measured, drawn = average_planners([sums({"r": 0.9})], ["r"], 0)
    assert (measured.low, measured.high) == (None, None)
    (pair,) = compare_entries([("a", 0.9, drawn), ("b", 0.1, drawn - 0.8)], enough=False)
    assert not pair.told_apart and pair.difference.low is None
    assert rank_entries(["a", "b"], [pair]) == {"a": (1, 2), "b": (1, 2)}


def test_the_command_scores_and_refuses(entry: Path, base: DataSet, tmp_path: Path) -> None:
    arguments = ("--base", base.root, "--model", "constant-velocity", "--out", tmp_path, "--workers", "1")
    done = run_here("challenge", "score", entry, *arguments, "--json")
    assert done.code == 0, done.err
    (found,) = find_scores(tmp_path / "challenge")
    assert json.loads(done.out)["entries"][0]["entry"]["name"] == "honest" == found.entries[0].entry.name
    for extra, says in (
        ((entry, "--model", "constant-velocty"), "constant-velocity"),
        ((entry, "--protocol", "exat"), "exat"),
        ((entry, "--protocol", "native"), "no native protocol"),
        ((tmp_path / "none",), "does not exist"),
        ((entry, entry), "named twice"),
    ):
        done = run_here("challenge", "score", *extra, *arguments)
        assert done.code == 2 and says in done.err and done.err.count("error") == 0, done


def test_the_same_data_twice_and_damaged_scores_are_refused(entry: Path, base: DataSet, tmp_path: Path) -> None:
    data, ours, theirs = open_data(entry), tmp_path / "ours" / "adv", tmp_path / "theirs" / "adv"
    with pytest.raises(InputError, match="the same data"):
        score_entries({"a": data, "b": data}, base, [planner_factory(STEADY)], ScoreSettings(tmp_path))
    # Names of entries are as long as they must be.
    assert set(name_entries([ours])) == {"adv"} and set(name_entries([ours, theirs])) == {"ours/adv", "theirs/adv"}
    (tmp_path / "scores-a.json").write_text('{"format": "challenger-bench challenge scores"}')
    with pytest.raises(InputError, match="damaged"):
        read_scores(tmp_path / "scores-a.json")
