from pathlib import Path

from generation.pipeline.said_settings import said_settings
from generation.pipeline.settings import BuildSettings
from generation.search.hyperparameters import HyperParameters, Launch
from generation.search.presets import PRESETS, hyper_parameters
from generation.splits.packaged import frozen_split, newest_split


def test_the_default_threatens_and_no_other_preset_does() -> None:
    assert [preset for preset in PRESETS if hyper_parameters(preset).threatens] == ["default"]
    assert hyper_parameters("default").launch is Launch.REACH
    assert hyper_parameters("near") == HyperParameters()


def test_presets_are_four_searches() -> None:
    assert len({hyper_parameters(preset).fingerprint for preset in PRESETS}) == 4


def test_paper_and_reference_are_what_they_were_before_there_were_threats() -> None:
    """Their keys as they were then: whatever was kept of them is found."""
    assert hyper_parameters("near").fingerprint.startswith("573166c9f00d3abd")
    assert hyper_parameters("paper").fingerprint.startswith("88a7130a0cd66adf")
    assert hyper_parameters("reference").fingerprint.startswith("19765d033fabf710")


def test_the_newest_frozen_split_still_says_its_settings(tmp_path: Path) -> None:
    assert newest_split("mini").frozen.search.hyper == hyper_parameters().fingerprint
    said = said_settings(tmp_path, {"frozen": {"name": newest_split("mini").name}})
    assert (said["launch"], said["threat_weight"], said["ac_weight"]) == ("reach", 10.0, 0.0)


def test_a_frozen_split_of_before_the_terms_is_of_the_preset_near(tmp_path: Path) -> None:
    assert frozen_split("mini-adv-2").frozen.search.hyper == hyper_parameters("near").fingerprint
    said = said_settings(tmp_path, {"frozen": {"name": "mini-adv-2"}})
    assert (said["launch"], said["threat_weight"], said["ac_weight"]) == ("near", 0.0, 1.0)


def test_a_build_from_python_searches_as_the_command_does() -> None:
    assert BuildSettings(out=Path()).hyper == hyper_parameters()
