"""`verify drivers`, `severity`, `realism`: golden numbers are met, a changed one is found, broken sets are refused."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.drivers import BUILT_IN as DRIVERS
from benchmark.extensions.golden_sets.drivers import verify_drivers
from benchmark.extensions.golden_sets.realism import BUILT_IN as REALISM
from benchmark.extensions.golden_sets.realism import verify_realism
from benchmark.extensions.golden_sets.severity import BUILT_IN as SEVERITY
from benchmark.extensions.golden_sets.severity import verify_severity
from benchmark.verification.checks import Check
from tests.benchmark.cli.cli_runs import challenger_bench
from tests.benchmark.extensions.golden_sets.golden_judgement import SHARED, made_driver_scenes, made_realism

Verify = Callable[[Path | None], list[Check]]
SETS: dict[str, tuple[Verify, Path]] = {
    "drivers": (verify_drivers, DRIVERS),
    "severity": (verify_severity, SEVERITY),
    "realism": (verify_realism, REALISM),
}


def copied(kind: str, folder: Path) -> Path:
    return Path(shutil.copytree(SETS[kind][1], folder / kind))


def change_arrays(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    with np.load(path) as stored:
        arrays = {name: stored[name].copy() for name in stored.files}
    change(arrays)
    np.savez(path, **arrays)


def change_facts(path: Path, change: Callable[[Any], None]) -> None:
    facts = json.loads(path.read_text())
    change(facts)
    path.write_text(json.dumps(facts))


@pytest.mark.parametrize("kind", SETS)
def test_the_built_in_set_agrees(kind: str) -> None:
    checks = SETS[kind][0](None)
    assert [check.quantity for check in checks if not check.ok] == []


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden numbers are not here")
def test_every_golden_number_is_met(kind: str) -> None:
    checks = SETS[kind][0](SHARED / kind)
    assert [check.quantity for check in checks if not check.ok] == []
    assert sum(check.count for check in checks) > 10_000


def test_what_is_made_up_in_the_sets_is_what_the_program_makes_up() -> None:
    arrays, facts = made_driver_scenes()
    stored = json.loads((DRIVERS / "scenes.json").read_text())
    assert [each["scene"] for each in stored] == [each["scene"] for each in facts]
    with np.load(DRIVERS / "scenes.npz") as held:
        assert set(held.files) == set(arrays)
        for name in held.files:
            if held[name].dtype.kind == "f":
                assert held[name] == pytest.approx(arrays[name], abs=2e-6), name
    made, _ = made_realism()
    for name, again in made.items():
        with np.load(REALISM / f"{name}.npz") as held:
            assert set(held.files) == set(again), name
    hits = [driver for each in stored for driver, facts in each["drivers"].items() if facts["contact"]]
    assert "recorded" in hits and len(hits) < sum(len(each["drivers"]) for each in stored)


@pytest.mark.parametrize(
    ("kind", "file", "array", "found"),
    [
        ("drivers", "straight", "speed", "straight, cc: speed (m/s)"),
        ("drivers", "straight", "crash_step", "straight, cc: crash_step"),
        ("drivers", "functions", "pfs", "function pfs"),
        ("drivers", "tables_following", "impact", "tables of following: impact (m/s)"),
        ("drivers", "encounters", "cut_in/cc/station", "encounters: station"),
        ("severity", "encounters", "cut_in/gap", "encounters: gap"),
        ("severity", "manoeuvres", "cut_in/4/0", "manoeuvres: states"),
        ("realism", "ctg_histograms", "ctg/scene/None/recorded/velocity", "ctg: histograms of agents"),
        ("realism", "plain_features", "recorded/scene-made-0/0/0/yaw_rate", "features: yaw_rate"),
    ],
)
def test_one_changed_number_is_found(kind: str, file: str, array: str, found: str, tmp_path: Path) -> None:
    def change(arrays: dict[str, Any]) -> None:
        arrays[array].reshape(-1)[0] += 1

    folder = copied(kind, tmp_path)
    change_arrays(folder / f"{file}.npz", change)
    assert found in [check.quantity for check in SETS[kind][0](folder) if not check.ok]


@pytest.mark.parametrize(
    ("kind", "file", "change", "found"),
    [
        ("drivers", "encounters", lambda f: f[0]["drivers"]["cc"].update(reacted=1.0), "encounters: first unsafe step"),
        ("drivers", "scenes", lambda f: f[0].update(first_visible=3.0), "scenes: first visible"),
        ("drivers", "scenes", lambda f: f[0]["drivers"]["recorded"].update(contact=None), "scenes: survives"),
        ("severity", "contacts", lambda f: f["cases"][0]["expected"].update(type="rear"), "contacts: type"),
        (
            "severity",
            "contacts",
            lambda f: f["cases"][0]["official_nuplan"].update(delta_v=9.0),
            "official: delta_v (m/s)",
        ),
        (
            "severity",
            "encounters",
            lambda f: f[0]["last_chance"]["evaluated"].update({"0": 4}),
            "last chance: evaluations",
        ),
        ("severity", "encounters", lambda f: f[0]["severity"].update(pet=1.0), "encounters: pet"),
        ("realism", "plain_divergences", lambda f: f["arrays"][0].update(w1=9.0), "arrays: w1"),
        (
            "realism",
            "plain_divergences",
            lambda f: f["halves"]["ttc"].update(jsd=0.9),
            "divergences of stored features: jsd",
        ),
        (
            "realism",
            "ctg_deviations",
            lambda f: f["old/scene/None"]["rotated"].update(mean_real_dev=0.5),
            "ctg: agents' means",
        ),
    ],
)
def test_one_changed_fact_is_found(
    kind: str, file: str, change: Callable[[Any], None], found: str, tmp_path: Path
) -> None:
    folder = copied(kind, tmp_path)
    change_facts(folder / f"{file}.json", change)
    assert found in [check.quantity for check in SETS[kind][0](folder) if not check.ok]


def test_a_fragile_outcome_is_left_out(tmp_path: Path) -> None:
    def change(facts: Any) -> None:
        facts[0]["drivers"]["cc"].update(reacted=1.0, fragile=True)

    folder = copied("drivers", tmp_path)
    change_facts(folder / "encounters.json", change)
    assert all(check.ok for check in verify_drivers(folder))

    def change_severity(facts: Any) -> None:
        facts[0]["severity"].update(pet=1.0)
        facts[0]["fragile"] = ["pet"]

    folder = copied("severity", tmp_path)
    change_facts(folder / "encounters.json", change_severity)
    assert all(check.ok for check in verify_severity(folder))


def _lose(path: Path) -> None:
    path.unlink()


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("damage", [_lose, _truncate, _empty])
def test_a_damaged_file_is_refused(kind: str, damage: Callable[[Path], None], tmp_path: Path) -> None:
    folder = copied(kind, tmp_path)
    kept = tmp_path / "kept"
    for path in sorted(folder.iterdir()):
        shutil.copy(path, kept)
        damage(path)
        if damage is _lose and path.name.startswith(("tables_", "scene-")):
            shutil.copy(kept, path)
            continue
        with pytest.raises(InputError):
            SETS[kind][0](folder)
        shutil.copy(kept, path)


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("other", ["[]", "{}", '[{"name": 3}]', "null"])
def test_json_of_another_form_is_refused(kind: str, other: str, tmp_path: Path) -> None:
    folder = copied(kind, tmp_path)
    for path in folder.glob("*.json"):
        path.write_text(other)
    with pytest.raises(InputError, match="json"):
        SETS[kind][0](folder)


@pytest.mark.parametrize(
    ("kind", "file"),
    [("drivers", "functions"), ("drivers", "straight"), ("severity", "encounters"), ("realism", "plain_arrays")],
)
@pytest.mark.parametrize("other", [{}, {"gap": np.array("x")}, {"gap": np.array([np.nan])}])
def test_arrays_of_another_form_are_refused(kind: str, file: str, other: dict[str, Any], tmp_path: Path) -> None:
    folder = copied(kind, tmp_path)
    np.savez(folder / f"{file}.npz", **other)
    with pytest.raises(InputError, match=file):
        SETS[kind][0](folder)


@pytest.mark.parametrize("kind", SETS)
def test_an_empty_folder_is_one_sentence_and_exit_code_2(kind: str, tmp_path: Path) -> None:
    said = challenger_bench("verify", kind, "--golden", str(tmp_path))
    assert said.code == 2 and said.err.count("\n") == 1 and str(tmp_path) in said.err
    said = challenger_bench("verify", kind, "--golden", str(tmp_path / "absent"))
    assert said.code == 2
