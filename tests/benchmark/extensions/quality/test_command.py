"""``quality`` as a user runs it."""

from pathlib import Path

from tests.benchmark.cli import test_bad_input as any_command


def test_adversarial_scenes_are_never_val(tmp_path: Path) -> None:
    road = any_command.write_road(tmp_path / "road")
    any_command.test_adversarial_scenes_are_never_val(road, tmp_path, ("quality", "--masks", "boxes"), "--split")
