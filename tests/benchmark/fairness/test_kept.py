"""Records of data sets that bring no judgements have them all the same; they are made once."""

from pathlib import Path

import pytest

from benchmark.datasets.roots import DataSet
from benchmark.datasets.scene_assessments import ASSESSMENTS_FILE
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.fairness.data_set_assessment import CACHE_FOLDER, collect_scene_facts
from benchmark.machine.workers import LocalProcesses
from tests.benchmark.fairness.test_data_set_assessment import SCENES, adversarial_scenes, recorded_scenes, written
from tests.benchmark.planners import Straight
from tests.executors import Forbidden


@pytest.fixture(scope="module")
def adversarial(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return written(tmp_path_factory.mktemp("made") / "adv", adversarial_scenes("n008"), made_from=True)


def test_scenes_are_judged_once_for_all_planners(adversarial: DataSet, tmp_path: Path) -> None:
    first = collect_scene_facts(adversarial, SCENES, tmp_path, LocalProcesses(1))
    assert all(facts.judgement is not None for facts in first.values())
    assert first == collect_scene_facts(adversarial, SCENES, tmp_path, Forbidden())
    part = collect_scene_facts(adversarial, SCENES[:1], tmp_path / "elsewhere", LocalProcesses(1))
    assert part[SCENES[0]] == first[SCENES[0]]
    whole = collect_scene_facts(adversarial, SCENES, tmp_path / "elsewhere", LocalProcesses(1))
    assert whole == first


def test_recordings_are_not_judged(tmp_path: Path) -> None:
    data = written(tmp_path / "val", recorded_scenes("n008"), made_from=False)
    facts = collect_scene_facts(data, data.scene_names("val"), tmp_path, Forbidden())
    assert all(each.judgement is None for each in facts.values()) and not (tmp_path / CACHE_FOLDER).exists()


def test_records_have_them_and_damage_is_one_sentence(adversarial: DataSet, tmp_path: Path) -> None:
    record = evaluate(adversarial, "adv", Straight(), tmp_path, EvalSettings(protocols=("exact",)))
    said = [record.run.scene_facts[name].judgement for name in SCENES]
    assert all(each is not None for each in said)
    (kept,) = tmp_path.rglob(ASSESSMENTS_FILE)
    kept.write_text("{")
    with pytest.raises(InputError, match=ASSESSMENTS_FILE):
        evaluate(adversarial, "adv", Straight(), tmp_path, EvalSettings(protocols=("exact",)))
