"""The figure of attack success against realism: which settings there are, where they stand, and when there is none."""

from benchmark.report.plots import read_png_size
from leaderboard.figures.contents import (
    REALISM_AXIS,
    VALIDITY_AXIS,
    attack_figures,
    explain_missing_figure,
    list_generator_settings,
)
from leaderboard.frame.runs import DataSetRuns
from tests.benchmark.metrics.made_attacks import attacked, with_realism
from tests.benchmark.records.hand_made_records import CLEAN, hand_made

SCENES = {"a": "f...", "b": "F...", "c": "...."}
CAREFUL = {"a": True, "b": False, "c": True}


def test_a_setting_is_a_split_with_all_its_planners() -> None:
    town = [with_realism(attacked(name, SCENES, CAREFUL, data="town"), None) for name in ("p", "q")]
    real = [
        with_realism(attacked("p", SCENES, CAREFUL, data="real", split=split), 0.7) for split in ("adv", "adv-seed-1")
    ]
    found = list_generator_settings([*town, *real, hand_made("p", {"a": [CLEAN]}, split="val", data="real")])
    assert [(each.data_name, each.split, len(each.success)) for each in found] == [
        ("real", "adv", 1),
        ("real", "adv-seed-1", 1),
        ("town", "adv", 2),
    ]
    assert found[0].worst is not None and found[0].worst.realism == 0.7 and found[2].worst is None
    assert found[0].success[0][1].numerator == 1 and found[0].success[0][1].denominator == 3
    assert found[2].without_fault.numerator == 2


def test_realism_and_validity_have_axes_of_their_own() -> None:
    town = with_realism(attacked("<p>", SCENES, CAREFUL, data="town"), None)
    real = with_realism(attacked("<p>", SCENES, CAREFUL, data="real"), 0.7)
    (both,) = attack_figures(DataSetRuns("town", [town, real]))
    text = both.svg.decode()
    assert _drawn(text, REALISM_AXIS) and _drawn(text, VALIDITY_AXIS)
    assert _drawn(text, "&lt;p&gt;") and _drawn(text, "worst: jerk along")
    (alone,) = attack_figures(DataSetRuns("real", [real]))
    assert not _drawn(alone.svg.decode(), VALIDITY_AXIS) and read_png_size(alone.png)[0] < read_png_size(both.png)[0]
    assert attack_figures(DataSetRuns("real", [real]))[0].png == alone.png
    # The own setting is full, that of another data set is hollow.
    assert attack_figures(DataSetRuns("real", [town, real]))[0].png != both.png


def test_where_nothing_can_be_drawn_a_sentence_says_why() -> None:
    unjudged = attacked("p", SCENES, dict.fromkeys(SCENES))
    assert attack_figures(DataSetRuns("d", [unjudged])) == ()
    assert explain_missing_figure("d", [unjudged]) == (
        "No figure of attack success against realism: the avoidability of no scene was assessed."
    )
    old = hand_made("p", {"a": [CLEAN]})
    assert "the severity of its plans" in (explain_missing_figure("d", [old]) or "")
    assert explain_missing_figure("d", [hand_made("p", {"a": [CLEAN]}, split="val")]) is None
    drawn = attacked("p", SCENES, CAREFUL)
    assert explain_missing_figure("d", [drawn]) is None and explain_missing_figure("other", [drawn]) is None


def _drawn(svg: str, words: str) -> bool:
    """Whether a text is in a drawing; its letters are paths, its words comments."""
    return f"<!-- {words}" in svg or f"; {words}" in svg or words in svg
