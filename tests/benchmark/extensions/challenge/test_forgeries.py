import shutil
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.extensions.challenge.checking import check_entry
from benchmark.extensions.challenge.rules import RULE_SETS, ChallengeRules
from benchmark.records.challenge import EntryVerdict
from tests.benchmark.extensions.challenge.forgeries import FORGERIES, Forgery
from tests.benchmark.extensions.challenge.small_entries import Forged, cut_in, recording, write

NAME = "scene-9901-a"


def check(
    root: Path, base: DataSet, rules: ChallengeRules | None = None, names: tuple[str, ...] | None = (NAME,)
) -> EntryVerdict:
    return check_entry(open_data(root), base, rules or ChallengeRules(), names)


def test_an_honest_entry_is_accepted_by_all_sets_of_rules(entry: Path, base: DataSet) -> None:
    for rules in RULE_SETS.values():
        verdict = check(entry, base, rules, None)
        assert verdict.accepted, verdict
        assert [len(scene.changed) for scene in verdict.scenes] == [1, 1]
        assert all(scene.images == 6 * 16 and not scene.notes for scene in verdict.scenes)


@pytest.mark.parametrize("forgery", FORGERIES, ids=lambda forgery: forgery.name)
def test_every_forgery_is_found(forgery: Forgery, entry: Path, base: DataSet, place: Path) -> None:
    root = place / "forged"
    shutil.rmtree(root, ignore_errors=True)
    forgery.forge(Forged.copy(entry, root))
    if forgery.rule is None:
        with pytest.raises(InputError) as refused:
            check(root, base)
        assert forgery.says in str(refused.value) and "\n" not in str(refused.value)
        return
    verdict = check(root, base)
    assert not verdict.accepted
    reasons = verdict.scenes[0].reasons
    found = [reason for reason in reasons if reason.rule.startswith(forgery.rule)]
    assert any(forgery.says in reason.sentence for reason in found), reasons


def test_the_same_scene_twice_and_too_many_of_one_recording(base: DataSet, tmp_path: Path) -> None:
    scene = recording("scene-9901")
    ways = [(4.0, "scene-9901-a"), (4.0, "scene-9901-b"), (5.0, "scene-9901-c")]
    root = write(tmp_path / "entry", "adv", [(cut_in(scene, over_s=over_s), name) for over_s, name in ways]).root
    verdict = check(root, base, ChallengeRules.model_validate({"scenes": {"most_of_one": 2}}), None)
    assert [scene.accepted for scene in verdict.scenes] == [True, False, True]
    assert [reason.sentence for reason in verdict.scenes[1].reasons] == ["repeats the scene scene-9901-a"]
    assert [reason.rule for reason in verdict.reasons] == ["scenes.most_of_one"]


def test_scenes_that_are_missing_are_bad_input(entry: Path, base: DataSet) -> None:
    required = ChallengeRules.model_validate({"scenes": {"required": ["scene-9902", "scene-9903"]}})
    with pytest.raises(InputError, match="no scene made from scene-9903, 1 of 2 recordings that the rules require"):
        check(entry, base, required, None)
    assert check(entry, base, required, (NAME,)).accepted
    with pytest.raises(InputError, match="did you mean scene-9901-a"):
        check(entry, base, None, ("scene-9901-q",))


@pytest.mark.parametrize(
    ("rules", "broken"),
    [
        ({"images": {"width": 1600, "height": 900}}, ["images.width"]),
        ({"gaps": {"others_m": 20.0, "ego_m": 20.0}}, ["gaps.ego_m", "gaps.others_m"]),
        ({"changed": {"least": 2, "most": 2}}, ["changed.least"]),
    ],
)
def test_rules_may_ask_for_more(rules: dict[str, Any], broken: list[str], entry: Path, base: DataSet) -> None:
    reasons = check(entry, base, ChallengeRules.model_validate(rules)).scenes[0].reasons
    assert list(dict.fromkeys(reason.rule for reason in reasons)) == broken
