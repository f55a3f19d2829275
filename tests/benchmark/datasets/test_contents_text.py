from typing import Any

from benchmark.datasets.contents import format_contents

FOUND: dict[str, Any] = {
    "name": "adv",
    "root": "/data/adv",
    "version": "v1.0-trainval",
    "fingerprint": "f" * 64,
    "made_from": {"name": "mini", "fingerprint": "0123456789abcdef" * 4},
    "splits": {
        "adv": {
            "scenes": [f"scene-{number:04d}-{number:08x}" for number in range(30)],
            **{"samples": 1200, "instances": 720, "annotations": 158400, "adversaries": 30},
        }
    },
    "unusable_splits": {},
}


def test_a_data_set_is_told_in_words_and_a_table_not_in_dictionaries() -> None:
    text = format_contents(FOUND, 80)
    assert not set("{}[]'") & set(text)
    assert all(len(line) <= 80 for line in text.splitlines())
    assert "made from:   mini (0123456789ab…)" in text and "158,400" in text
    assert "scene-0023" in text and "scene-0024" not in text and "6 more" in text


def test_recordings_are_made_from_nothing_and_foreign_provenance_is_no_crash() -> None:
    assert "made from" not in format_contents({**FOUND, "made_from": None}, 80)
    assert "made from" not in format_contents({**FOUND, "made_from": "somewhere"}, 80)
