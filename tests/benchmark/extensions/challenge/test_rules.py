from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as some

from benchmark.errors import InputError
from benchmark.extensions.challenge.rules import RULE_SETS, ChallengeRules, format_rules, read_rules


def read(folder: Path, text: str) -> ChallengeRules:
    path = folder / "rules.toml"
    path.write_text(text)
    return read_rules(path)


def test_no_file_and_an_empty_one_are_the_defaults(tmp_path: Path) -> None:
    assert read_rules(None) == ChallengeRules() == read(tmp_path, "")


def test_what_is_written_is_read(tmp_path: Path) -> None:
    for rules in RULE_SETS.values():
        assert read(tmp_path, format_rules(rules)) == rules
    assert all("  # " in line for line in format_rules(ChallengeRules()).splitlines()[1:] if line)


@given(
    name=some.text(some.characters(codec="utf-8", exclude_characters="\n")),
    most=some.integers(1, 9),
    position_m=some.floats(0, 1e6),
    categories=some.lists(some.text(some.characters(codec="utf-8")), max_size=3),
)
def test_any_rules_survive_their_file(
    tmp_path_factory: pytest.TempPathFactory, name: str, most: int, position_m: float, categories: list[str]
) -> None:
    said = {"most": most, "categories": categories}
    rules = ChallengeRules.model_validate({"name": name, "changed": said, "unchanged": {"position_m": position_m}})
    assert read(tmp_path_factory.mktemp("rules"), format_rules(rules)) == rules


def test_the_name_decides_nothing(tmp_path: Path) -> None:
    assert read(tmp_path, 'name = "another"').fingerprint == ChallengeRules().fingerprint
    assert read(tmp_path, "[changed]\nmost = 2").fingerprint != ChallengeRules().fingerprint


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[changed]\nmost = -1", "changed.most"),
        ("[changed]\nleast = 3", "at least 3 and at most 1"),
        ("[changed]\nmots = 2", "changed.mots"),
        ("[motion]\nbraking_m_s2 = nan", "motion.braking_m_s2"),
        ("[motion]\nbraking_m_s2 = 'hard'", "motion.braking_m_s2"),
        ("schema = 2", "schema"),
        ("[changed", "not valid TOML"),
        ("a = " + "[" * 5000, "not valid TOML"),
    ],
)
def test_rules_that_cannot_be_are_refused_in_a_sentence(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        read(tmp_path, text)
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        read_rules(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not valid TOML"):
        read_rules(tmp_path / "binary.toml")
