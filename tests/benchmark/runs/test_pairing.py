"""An adversarial record names the record that it is compared with, in its own data set or in the one that is named."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.evaluation import EvalSettings, evaluate
from benchmark.metrics.attacks import attack_rates_to_json
from benchmark.metrics.effect import compute_effect, effect_to_json
from benchmark.metrics.unchanged_records import find_unchanged_candidates, find_unchanged_record
from benchmark.records.run import load_record
from benchmark.records.store import ROWS_FILE
from leaderboard.build import build_leaderboard_tables
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.attacks import success_table
from leaderboard.tables.effect import effect_table
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Straight
from tests.benchmark.test_evaluation import contents


class Published(FakeData):
    """Scenes called after their recordings, as Adv-nuSc is published: who the adversary is, it does not say."""

    def split_names(self) -> tuple[str, ...]:
        return ("adv",)

    def scene_names(self, split: str | None = None) -> tuple[str, ...]:
        return tuple(sorted(self.scenes)) if split in (None, "adv") else ()


@pytest.fixture
def published() -> FakeData:
    scenes = town_of_two(slow_leader=True).scenes
    return Published({f"{name}-ab12": replace(scene, name=f"{name}-ab12") for name, scene in scenes.items()}, name="p")


def test_published_scenes_are_paired_with_the_recordings_of_the_data_set_that_is_named(
    published: FakeData, tmp_path: Path
) -> None:
    val = evaluate(town_of_two(), "val", Straight(), tmp_path)
    alone = evaluate(published, "adv", Straight(), tmp_path)
    assert alone.run.unchanged is None
    table = effect_table(DataSetRuns("p", [alone], find_unchanged_candidates(tmp_path, [alone])))
    assert table is not None and set(table.rows[0][2:]) == {"–"}
    assert any("name it here with --unchanged" in note for note in table.notes)
    named = EvalSettings(unchanged="fake")
    paired = evaluate(published, "adv", Straight(), tmp_path, named)
    said = paired.run.unchanged
    assert said is not None and (said.data, said.split) == (val.run.data, "val")
    assert said.samples == val.run.files[ROWS_FILE]
    assert load_record(paired.directory).run == paired.run
    kept = contents(paired.directory)
    assert contents(evaluate(published, "adv", Straight(), tmp_path, named).directory) == kept
    # Whoever is an adversary is not known, so that nothing is attributed; the pairs are there all the same.
    effect = compute_effect(paired, find_unchanged_record(paired, find_unchanged_candidates(tmp_path, [paired])))
    assert effect is not None and effect.touched is None and effect.paired is not None
    assert effect.paired.pairs == effect.samples > 0 and effect.paired.new_others is None
    assert (effect.paired.difference.value or 0.0) > 0.0
    told = effect_to_json(paired, val)["effect"]
    assert told["adversary"] is None and told["unchanged"] == {"data": "fake", "split": "val"}
    assert told["paired"]["pairs"] == effect.paired.pairs and effect_to_json(val, None) == {}
    # Nor is success 0 %: it cannot be told.
    assert success_table(DataSetRuns("p", [paired])) is None and attack_rates_to_json(paired) == {}
    table = next(table for table in build_leaderboard_tables([val, paired])[1].tables if table.name == "effect")
    row = dict(zip(table.columns, table.rows[0]))
    assert row["compared with"] == "val" and row["adversary 3s"] == row["new others"] == "–"
    assert row["difference"].startswith("+")


def test_recordings_have_no_partner_and_records_of_other_planners_are_none(published: FakeData, tmp_path: Path) -> None:
    class Other(Straight):
        name = "other"

    evaluate(town_of_two(), "val", Other(), tmp_path)
    assert evaluate(town_of_two(), "val", Straight(), tmp_path).run.unchanged is None
    elsewhere = EvalSettings(unchanged="nowhere")
    assert evaluate(published, "adv", Straight(), tmp_path, elsewhere).run.unchanged is None
