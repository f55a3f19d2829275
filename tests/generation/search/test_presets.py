from pathlib import Path

from generation.pipeline.recorded_settings import read_recorded_settings
from generation.pipeline.settings import BuildSettings
from generation.search.hyperparameters import HyperParameters, LaunchRule
from generation.search.presets import PRESETS, build_hyper_parameters
from generation.splits.packaged import read_frozen_split, read_newest_split


def test_the_default_threatens_and_no_other_preset_does() -> None:
    assert [preset for preset in PRESETS if build_hyper_parameters(preset).threatens] == ["default"]
    assert build_hyper_parameters("default").launch is LaunchRule.REACH
    assert build_hyper_parameters("near") == HyperParameters()


def test_paper_and_reference_are_what_they_were_before_there_were_threats() -> None:
    """Their keys as they were then: whatever was kept of them is found."""
    assert build_hyper_parameters("near").fingerprint.startswith("573166c9f00d3abd")
    assert build_hyper_parameters("paper").fingerprint.startswith("88a7130a0cd66adf")
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
