import runpy
from dataclasses import fields, replace
from pathlib import Path

from generation.search.differences_from_paper import (
    INTERPRETATIONS,
    PAPER,
    REFERENCE,
    format_differences,
    list_differences,
)
from generation.search.hyperparameters import HyperParameters

ROOT = Path(__file__).resolve().parents[3]


def test_the_page_of_differences_is_what_the_presets_say() -> None:
    made = runpy.run_path(str(ROOT / "docs" / "making" / "differences.py"))
    text = made["build_page"]()
    assert made["PAGE"].read_text() == text, "run python docs/making/differences.py"
    for point in (*PAPER, *REFERENCE):
        assert f"| {point.said} | {point.replacement} | {point.reason} |" in text
    for reading in INTERPRETATIONS:
        assert f"| {reading.open} | {reading.taken} | {reading.why} |" in text
    assert "(reference/differences-from-paper.md)" in (ROOT / "docs" / "generation.md").read_text()


def test_the_default_follows_neither_and_has_no_departures() -> None:
    assert format_differences("default", HyperParameters()) == []


def test_every_departure_has_its_reason() -> None:
    for preset, hyper, known in (
        ("paper", HyperParameters.paper(), PAPER),
        ("reference", HyperParameters.reference(), REFERENCE),
    ):
        assert list_differences(preset, hyper) == known
        lines = format_differences(preset, hyper)
        assert lines[0].endswith(f"in {len(known)} points:")
        assert all(" because " in line for line in lines[1 : 1 + len(known)])
    assert len(format_differences("paper", HyperParameters.paper())) == 2 + len(PAPER) + len(INTERPRETATIONS)


def test_what_was_asked_for_is_a_departure_too() -> None:
    asked = HyperParameters.paper().changed(["varied=true", "tries=3"])
    lines = format_differences("paper", asked)
    assert lines[0].endswith(f"in {len(PAPER) + 2} points:")
    assert "- tries is 1; here it is 3, because it was asked for" in lines
    assert "- varied is False; here it is True, because it was asked for" in lines


def test_every_setting_of_the_presets_that_differs_from_ours_is_meant() -> None:
    """A setting that is added to the default alone must be thought about for the other two."""
    ours = HyperParameters()
    differing = {
        preset: {each.name for each in fields(ours) if getattr(settings, each.name) != getattr(ours, each.name)}
        for preset, settings in (("paper", HyperParameters.paper()), ("reference", HyperParameters.reference()))
    }
    both = {
        "staying_preference", "tries", "raster_ego", "best_of_all_rounds", "motion", "launch", "discards", "solvable",
    }  # fmt: skip
    code = {"lookahead_frames", "lookahead_challenge_weight", "clearance_m", "headway_s"}
    assert differing["reference"] == both | code | {"stable_softmax", "init_least", "score", "choice"}
    text = {"varied", "shortest_drive_frames", "least_drivable_share", "moving_ego_m_s"}
    assert differing["paper"] == both | text
    assert replace(HyperParameters.paper(), **{name: getattr(ours, name) for name in differing["paper"]}) == ours
