"""README's film, picture of the site and table belong together and to the package as it is."""

import json
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
PICTURES = runpy.run_path(str(ROOT / "docs" / "making" / "pictures.py"))
MADE = json.loads((ROOT / "docs" / "images" / "made.json").read_text())
ANEW = "run python docs/making/pictures.py"


def test_they_were_made_from_the_split_and_the_weights_of_the_package() -> None:
    assert MADE["made from"] == json.loads(json.dumps(PICTURES["describe_made_from"]())), ANEW


@pytest.mark.parametrize("name", ["film.webp", "site.png"])
def test_a_picture_is_the_one_that_was_made(name: str) -> None:
    assert MADE["sha256"][name] == PICTURES["hash_of"](ROOT / "docs" / "images" / name), ANEW
    assert f"](docs/images/{name})" in README


def test_readme_says_what_was_made_and_how() -> None:
    split = MADE["made from"]["frozen split"][0]
    assert MADE["table"] in README and MADE["command"] in README, ANEW
    assert f"`{split}`" in README and PICTURES["SCENE"].removeprefix("scene-") in README
