import pytest

from benchmark.report.words import inflect_noun, pluralise


@pytest.mark.parametrize(
    ("count", "one", "said"),
    [
        (0, "scene", "0 scenes"), (1, "scene", "1 scene"), (2, "recorded scene", "2 recorded scenes"),
        (1204, "sample", "1,204 samples"), (1, "quantity", "1 quantity"), (3, "quantity", "3 quantities"),
        (2, "day", "2 days"),
    ],
)  # fmt: skip
def test_numbers_with_their_nouns(count: int, one: str, said: str) -> None:
    assert pluralise(count, one) == said
    assert said.endswith(inflect_noun(count, one))


def test_a_plural_of_its_own() -> None:
    assert pluralise(2, "mouse", "mice") == "2 mice" and pluralise(1, "mouse", "mice") == "1 mouse"
