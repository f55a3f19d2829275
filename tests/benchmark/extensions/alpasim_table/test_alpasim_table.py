"""AlpaSim's table: its own files byte for byte, its order and scale, its refusals, and tables of drives of ours."""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.extensions.alpasim_table.subjects import SUMMARY, Subject, collect_subjects, read_subjects
from benchmark.extensions.alpasim_table.table import (
    MANIFEST,
    MATRIX,
    RANKING,
    AlpasimTable,
    Anchors,
    Posterior,
    build_alpasim_table,
    draw_ranks,
)
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.records.test_drives import failed, row, scores, written

GOLDEN = Path(__file__).resolve().parents[3] / "golden" / "irt"
SHARED = Path(__file__).resolve().parents[5] / "shared" / "golden" / "irt"
CASE = GOLDEN / "alpasim" / "guard-exactly-enough"
RULES = "alpasim@2026-09"


def policy(name: str, *values: float, km: float | None = None) -> Subject:
    return Subject(name, {f"scene-{place}": value for place, value in enumerate(values)}, km, f"runs/{name}/{SUMMARY}")


def ranking(table: AlpasimTable) -> list[dict[str, str]]:
    return list(csv.DictReader(table.files[RANKING].decode().splitlines()))


@pytest.mark.path
def test_the_command_writes_the_same_bytes_as_alpasim(tmp_path: Path) -> None:
    given = ("--posterior", str(CASE / "posterior_given.json"), "--algorithm", "zoib")
    done = run_here("leaderboard", "export-alpasim", "--runs", str(CASE / "runs"), *given, "--to", str(tmp_path / "to"))
    assert done.code == 0 and "planner-01, planner-05, planner-00, planner-03, planner-02, planner-04" in done.out
    for name in (MATRIX, RANKING, MANIFEST):
        assert (tmp_path / "to" / name).read_bytes() == (CASE / "expected" / name).read_bytes()


def test_the_cases_are_verified_and_a_changed_one_is_found(tmp_path: Path) -> None:
    done = run_here("verify", "ability", "--golden", str(GOLDEN / "alpasim-refused"), "--json")
    (check,) = json.loads(done.out)
    assert done.code == 0 and (check["quantity"], check["count"]) == ("refused files", 6)
    assert run_here("verify", "ability", "--golden", str(GOLDEN / "alpasim")).code == 0
    shutil.copytree(GOLDEN / "alpasim", tmp_path / "alpasim")
    summary = tmp_path / "alpasim" / CASE.name / "runs" / "planner-03" / SUMMARY
    summary.write_text(summary.read_text().replace("11.046", "99.0"))
    changed = run_here("verify", "ability", "--golden", str(tmp_path / "alpasim"))
    assert changed.code == 1 and "FAIL  capability_ranking.csv" in changed.out


@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden tables are not beside this checkout")
def test_every_golden_table_is_met() -> None:
    checks = json.loads(run_here("verify", "ability", "--golden", str(SHARED / "alpasim"), "--json").out)
    assert len(checks) == 44 and all(check["ok"] and check["error"] == 0.0 for check in checks)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ({"rollouts": [{"scene_id": "a", "score": 1.2}]}, "outside"),
        ({"rollouts": [{"scene_id": "a", "score": float("nan")}]}, "outside"),
        ({"scene_score_enabled": False, "rollouts": [{"scene_id": "a", "score": 0.2}]}, "scene scoring disabled"),
        ({"rollouts": [{"scene_id": "a", "score": "0.5"}, {"score": 0.5}, "junk", None]}, "no valid scene scores"),
        ({"rollouts": {"scene_id": "a"}}, "no valid scene scores"),
        ([], "is no object"),
    ],
)
def test_files_that_alpasim_refuses_are_refused(tmp_path: Path, content: Any, why: str) -> None:
    path = tmp_path / "runs" / "a" / SUMMARY
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(content))
    said = refusal("leaderboard", "export-alpasim", "--runs", str(tmp_path / "runs"), "--to", str(tmp_path / "to"))
    assert why in said and not (tmp_path / "to").exists()


def test_rollouts_of_a_scene_are_averaged_and_odd_items_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "a" / SUMMARY
    path.parent.mkdir(parents=True)
    items = [{"clipgt_id": "x", "score": 0}, {"clipgt_id": "x", "score": 1}, {"scene_id": "y", "score": True}]
    results: list[Any] = [{"avg_dist_between_incidents_at_fault": None}]
    path.write_text(json.dumps({"rollouts": [*items, {"scene_id": 7, "score": 1}], "metrics_results": results}))
    (subject,) = read_subjects(tmp_path / "runs")
    assert subject == Subject("a", {"x": 0.5}, None, f"runs/a/{SUMMARY}")
    with pytest.raises(InputError, match="holds no"):
        read_subjects(tmp_path)


def test_policies_with_other_scenes_are_left_out_whole() -> None:
    table = build_alpasim_table([policy("b", 1.0, 0.0), policy("a", 1.0), policy("c", 0.5, 0.6), policy("d", 1.0)])
    assert table.order == ("c", "b") and b"scene-1\r\n" in table.files[MATRIX]
    (first, second) = json.loads(table.files[MANIFEST])["exclusions"]
    assert (first["subject_id"], second["subject_id"], first["scenario_count"]) == ("a", "d", 1)


def test_order_is_upper_rank_then_way_between_incidents_and_not_the_score() -> None:
    policies = [policy("a", *[0.5] * 6), policy("b", *[0.5] * 6, km=3.0), policy("c", *[0.5] * 6, km=9.0)]
    policies += [policy(name, *[0.1] * 6) for name in "def"]
    given = Posterior({"a": (1.2, 1.0), "b": (1.1, 1.0), "c": (1.0, 1.0), **dict.fromkeys("def", (-50.0, 1.0))})
    table = build_alpasim_table(policies, "zoib", given)
    assert table.order[:3] == ("c", "b", "a") and [each["point_estimate_rank"] for each in ranking(table)[:3]] == [
        *"321"
    ]
    with pytest.raises(InputError, match=r"missing: f; not in the table: g"):
        build_alpasim_table(policies, "zoib", Posterior({**dict.fromkeys("abcdeg", (0.0, 1.0))}))


def test_anchors_get_their_scores() -> None:
    policies = [policy("a", 0.2), policy("b", 0.6), policy("c", 0.4)]
    anchors = Anchors(frozenset("ab"), ("a", 600.0), ("b", 2000.0))
    shown = {each["subject_id"]: each for each in ranking(build_alpasim_table(policies, anchors=anchors))}
    assert float(shown["a"]["policy_capability_score"]) == pytest.approx(600.0)
    assert float(shown["b"]["policy_capability_score"]) == pytest.approx(2000.0)
    assert float(shown["c"]["policy_capability_score"]) == pytest.approx(1300.0, abs=1e-3)
    assert (shown["a"]["is_reference"], shown["c"]["is_reference"]) == ("True", "False")
    for wrong, reason in (
        (Anchors(frozenset(), ("b", 600.0), ("a", 2000.0)), "anchor_scores_not_monotone"),
        (Anchors(frozenset(), ("a", 600.0), ("z", 2000.0)), "anchor_subject_not_included"),
        (Anchors(frozenset(), ("a", 600.0), ("a", 2000.0)), "anchor_scores_not_monotone"),
    ):
        table = build_alpasim_table(policies, anchors=wrong)
        scale = json.loads(table.files[MANIFEST])["score_scale"]
        assert (scale["applied"], scale["reason"]) == (False, reason)
        assert float(ranking(table)[0]["policy_capability_score"]) == pytest.approx(0.6)


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(0.01, 2)), min_size=1, max_size=8))
@settings(max_examples=15, deadline=None)
def test_intervals_of_ranks_are_whole_ranks_around_what_is_certain(abilities: list[tuple[float, float]]) -> None:
    means, deviations = np.array(abilities).T
    ranks = draw_ranks(means, deviations)
    assert all(1 <= low <= high <= len(abilities) and low == int(low) and high == int(high) for low, high in ranks)
    certain = draw_ranks(np.arange(5.0), np.full(5, 1e-9))
    assert certain == [(float(rank), float(rank)) for rank in (5, 4, 3, 2, 1)]


@pytest.mark.parametrize(
    ("text", "reader"),
    [
        ('{"subject_ids": ["a"], "scores": [1.0]}', Posterior.read),
        ('{"subject_ids": ["a"], "scores": [1.0], "score_uncertainty": [-1.0]}', Posterior.read),
        ('{"subject_ids": ["a", "a"], "scores": [1, 2], "score_uncertainty": [1, 1]}', Posterior.read),
        ('{"subject_ids": ["a"], "scores": [NaN], "score_uncertainty": [1]}', Posterior.read),
        ("[]", Posterior.read),
        ("null", Posterior.read),
        ('{"score_scale": {}}', Anchors.read),
        ("[1]", Anchors.read),
        ('{"runs": [1], "score_scale": {}}', Anchors.read),
    ],
)
def test_damaged_files_of_abilities_and_anchors_are_refused(tmp_path: Path, text: str, reader: Any) -> None:
    (tmp_path / "file.json").write_text(text)
    with pytest.raises(InputError, match=r"file\.json (holds|has) no"):
        reader(tmp_path / "file.json")


def drive(scene: str, score: float, **parts: float) -> Any:
    none = dict.fromkeys(("front", "lateral", "rear", "off_road"), 0.0)
    return row(scene, scores=scores(further={RULES: {"score": score, "km": 0.5, **none, **parts}}))


def test_drives_of_ours_make_a_table_in_which_a_failed_drive_counts_nothing(tmp_path: Path) -> None:
    first = written(tmp_path / "drives" / "a", drive("scene-1", 0.0, front=1.0), drive("scene-2", 1.0))
    planner = {"name": "other", "privileged": False}
    written(tmp_path / "drives" / "b", drive("scene-1", 0.8, rear=1.0), failed("scene-2"), planner=planner)
    to = tmp_path / "to"
    done = run_here("leaderboard", "export-alpasim", "--out", str(tmp_path), "--to", str(to), "--json")
    assert done.code == 0 and json.loads(done.out)["order"] == ["made", "other"]
    rows = list(csv.DictReader((to / RANKING).read_text().splitlines()))
    assert [each["raw_policy_capability_score"][:4] for each in rows] == ["0.5", "0.40"]
    assert [each["avg_dist_between_incidents_at_fault"] for each in rows] == ["1.0", ""]
    with pytest.raises(InputError, match="has no alpasim@2026-09 of scene-1; run challenger-bench rescore"):
        collect_subjects([written(tmp_path / "c")], RULES)
    with pytest.raises(InputError, match="found fake ffffffff adv"):
        late = {"engine": "default", "agents": "replay", "sensor": "none", "latency_ms": 200}
        collect_subjects([first, written(tmp_path / "d", measured=late)], RULES)
    with pytest.raises(InputError, match="two records are of made"):
        collect_subjects([first, first], RULES)
    assert "found none" in refusal(
        "leaderboard", "export-alpasim", "--out", str(tmp_path), "--split", "val", "--to", str(to)
    )
    assert "--posterior applies only" in refusal(
        "leaderboard", "export-alpasim", "--to", str(to), "--posterior", str(CASE / "posterior_given.json")
    )
