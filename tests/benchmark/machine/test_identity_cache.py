"""What is remembered is what was made of the same object."""

from benchmark.machine.identity_cache import IdentityCache


def test_it_is_made_once_for_each_object_and_value_and_the_oldest_is_forgotten() -> None:
    made: list[tuple[str, int]] = []

    def make(source: list[str], number: int) -> list[str]:
        made.append((source[0], number))
        return [*source, str(number)]

    last = IdentityCache[list[str], list[str]](make, kept=2)
    first, equal = ["a"], ["a"]
    assert last(first, 1) is last(first, 1) and made == [("a", 1)]
    # Equal is not the same: what is equal now may be told apart by whoever made it.
    assert last(equal, 1) == ["a", "1"] and len(made) == 2
    assert last(first, 2) == ["a", "2"] and len(made) == 3
    last(first, 1)
    assert len(made) == 4
