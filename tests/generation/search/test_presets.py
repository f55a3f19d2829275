from dataclasses import asdict, replace
from pathlib import Path

from benchmark.cli.record_settings import read_generate_options
from generation.pipeline.recorded_settings import read_recorded_settings
from generation.pipeline.settings import BuildSettings
from generation.search.hyperparameters import HyperParameters, LaunchRule
from generation.search.presets import PRESETS, build_further_settings, build_hyper_parameters
from generation.splits.packaged import read_frozen_split, read_newest_split


def test_the_default_and_effect_threaten_and_no_other_preset_does() -> None:
    assert [preset for preset in PRESETS if build_hyper_parameters(preset).threatens] == ["default", "effect"]
    assert build_hyper_parameters("default").launch is LaunchRule.REACH
    assert build_hyper_parameters("near") == HyperParameters()


def test_presets_are_what_they_were() -> None:
    """Their keys: whatever was kept of them is found."""
    assert build_hyper_parameters("near").fingerprint.startswith("573166c9f00d3abd")
    assert build_hyper_parameters("paper").fingerprint.startswith("06dbd2758b3c2f70")
    assert build_hyper_parameters("reference").fingerprint.startswith("19765d033fabf710")


def test_the_newest_frozen_split_still_says_its_settings(tmp_path: Path) -> None:
    assert read_newest_split("mini").frozen.search.hyper == build_hyper_parameters().fingerprint
    said = read_recorded_settings(tmp_path, {"frozen": {"name": read_newest_split("mini").name}})
    assert (said["launch"], said["threat_weight"], said["ac_weight"]) == ("reach", 10.0, 0.0)


def test_a_frozen_split_of_before_the_terms_is_of_the_preset_near(tmp_path: Path) -> None:
    assert read_frozen_split("mini-adv-2").frozen.search.hyper == build_hyper_parameters("near").fingerprint
    said = read_recorded_settings(tmp_path, {"frozen": {"name": "mini-adv-2"}})
    assert (said["launch"], said["threat_weight"], said["ac_weight"]) == ("near", 0.0, 1.0)


def test_a_build_from_python_searches_as_the_command_does() -> None:
    assert BuildSettings(out=Path()).hyper == build_hyper_parameters()


def test_effect_searches_for_threat_nearness_and_edits() -> None:
    first, further = build_hyper_parameters("effect"), build_further_settings("effect")
    assert first == replace(build_hyper_parameters(), behaviour=True)
    assert [hyper.threatens for hyper in further] == [True, False, False, False, True]
    assert [hyper.proposal.value for hyper in further] == ["sampled", "retimed", "rerouted", "swerved", "sampled"]
    assert further[-1] == first
    assert all(hyper.behaviour and hyper.careful_survives for hyper in further)
    assert [build_further_settings(preset) for preset in PRESETS if preset != "effect"] == [()] * 4


def test_a_change_reaches_further_searches_that_have_the_same_value() -> None:
    given = {"candidates": 64}, ["threat_weight=5", "half_extent_m=40", "tries=4"]
    near, retimed, rerouted, swerved, again = build_further_settings("effect", *given)
    assert again == build_hyper_parameters("effect", *given)
    assert (near.candidates, near.threat_weight, near.half_extent_m, near.tries) == (64, 0.0, 40.0, 4)
    assert (retimed.threat_weight, retimed.half_extent_m, retimed.tries) == (0.0, 40.0, 6)
    assert rerouted.half_extent_m == swerved.half_extent_m == 40.0


def test_a_recorded_search_by_effect_gives_its_options_back() -> None:
    first, further = build_hyper_parameters("effect"), build_further_settings("effect")
    said = read_generate_options({
        "hyper": asdict(first), "hyper_fingerprint": "x", "seed": 3, "further": [asdict(hyper) for hyper in further],
    })  # fmt: skip
    assert said is not None
    changes = [
        f"{name}={str(value).lower() if isinstance(value, bool) else value}" for name, value in said["set"].items()
    ]
    assert said["preset"] == "effect"
    assert build_hyper_parameters("effect", None, changes) == first
    assert build_further_settings("effect", None, changes) == further
