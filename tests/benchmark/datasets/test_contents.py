"""What a data set holds, counted."""

from benchmark.datasets.contents import contents
from tests.benchmark.fake_data import town_of_two


def test_samples_objects_and_annotations_are_counted_by_split() -> None:
    found = contents(town_of_two(slow_leader=True))
    assert found["splits"]["val"] == {
        "scenes": ["scene-9901", "scene-9902"],
        "samples": 32,
        "instances": 6,
        "annotations": 6 * 16,
        "adversaries": 0,
    }
    assert (found["name"], found["made_from"]) == ("fake", None)
