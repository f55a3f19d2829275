"""Several planners or records in one pass: each scene is read once, and the bytes are those of one by one."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.evaluation import EvalSettings, evaluate, evaluate_together
from benchmark.records.run import load_record
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.runs.rescoring import rescore_all
from benchmark.truth import SampleTruth
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Failing, Remembering, Straight
from tests.benchmark.test_evaluation import contents


@dataclass(frozen=True)
class Made:
    """Builds a planner under its own name."""

    kind: type[Straight]

    @property
    def facts(self) -> PlannerFacts:
        return build_planner_facts(self.kind())

    def __call__(self) -> Straight:
        return self.kind()


@dataclass
class Counted(FakeData):
    reads: Counter[str] = field(default_factory=Counter)

    def truth(self, name: str) -> tuple[SampleTruth, ...]:
        self.reads[name] += 1
        return super().truth(name)


def counted() -> Counted:
    made = town_of_two(slow_leader=True)
    return Counted(made.scenes)


def test_planners_together_give_the_bytes_of_planners_one_by_one(tmp_path: Path) -> None:
    data, kinds = counted(), (Straight, Failing, Remembering)
    settings = EvalSettings(protocols=("exact", "uniad"))
    pairs = [(Made(kind), settings) for kind in kinds]
    records = evaluate_together(data, "val", pairs, tmp_path / "together")
    assert [record.planner for record in records] == [kind().name for kind in kinds]
    assert set(data.reads.values()) == {1}
    for kind in kinds:
        evaluate(data, "val", Made(kind), tmp_path / "alone", settings)
    assert contents(tmp_path / "together") == contents(tmp_path / "alone")
    evaluate_together(data, "val", pairs, tmp_path / "together")
    assert contents(tmp_path / "together") == contents(tmp_path / "alone")


def test_the_same_planner_twice_is_done_one_after_the_other(tmp_path: Path) -> None:
    first, second = evaluate_together(
        counted(), "val", [(Made(Straight), EvalSettings()), (Made(Straight), EvalSettings())], tmp_path
    )
    assert first.rows == second.rows and first.directory == second.directory


def test_records_are_judged_anew_scene_by_scene_and_a_damaged_one_stops_none(tmp_path: Path) -> None:
    data = counted()
    for kind in (Straight, Failing, Remembering):
        evaluate(data, "val", Made(kind), tmp_path, EvalSettings(protocols=("uniad",)))
    broken = tmp_path / "fake" / "val" / "failing" / "samples.jsonl"
    broken.write_text(broken.read_text()[:-9])
    data.reads.clear()
    found = {
        each.directory.name: each for each in rescore_all(tmp_path, lambda split: data, "fake", ("uniad", "exact"))
    }
    assert list(found) == sorted(found)
    assert [each.failed for each in found.values()] == [name == "failing" for name in found]
    assert {each.sentence for name, each in found.items() if name != "failing"} == {"rescored"}
    assert set(data.reads.values()) == {1}
    assert set(load_record(tmp_path / "fake" / "val" / "straight").run.protocols) == {"uniad", "exact"}
