"""The valid files of which hostile ones are made: small, of every kind, and the same each time."""

import json
import pickle
import shutil
from pathlib import Path
from typing import Any, Final

import numpy as np

from adapters.models import MOTION_ANCHORS
from bench.attacking.children import run_command
from bench.attacking.table import arguments
from benchmark.errors import InputError
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.render.schematic import SchematicRenderer
from tests.benchmark.datasets.nuscenes_tables import VERSION
from tests.benchmark.datasets.test_scenarionet import recording
from tests.generation.extensions.logs123d.made_logs import MadeLog
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import Car, scene_on_straight_road

RESULT_FORMATS: Final = ("uniad", "vad-out", "opendrivevla")
"""Of result files: tensors in a pickle by token and by place, and JSON."""
_CARS: Final = (Car(62.0, 194.75, 9.0), Car(95.0, 198.25, 8.0), Car(45.0, 201.75, 8.0))


def make_valid(folder: Path) -> Path:
    """Make them, where that has not been done.

    Args:
        folder: Holds everything of a campaign.

    Returns:
        Their folder: ``root`` and what was ``generated`` from it, ``recordings``, ``log123d``, ``records``, ``edited``
        scenes, and files.
    """
    valid = folder / "valid"
    if (valid / "complete").is_file():
        return valid
    shutil.rmtree(valid, ignore_errors=True)
    valid.mkdir(parents=True)
    write_recorded(valid / "root")
    for what in ("physics", "denoiser"):
        shutil.copytree(BUILT_IN / what, valid / f"golden-{what}")
    (valid / "recordings").mkdir()
    (valid / "recordings" / "sd_one.pkl").write_bytes(pickle.dumps(recording()))
    MadeLog(frames=11).write(valid / "log123d")
    write_weights(valid)
    write_plans(valid)
    _by_command(valid, "eval", "--model", "constant-velocity")
    _by_command(valid, "sheets", "--split", "val", "--pictures", "none")
    shutil.copytree(valid / "made", valid / "shown")
    (valid / "made" / "runs").rename(valid / "records")
    for name in RESULT_FORMATS:
        _by_command(valid, "eval", "--model", "constant-velocity", "--dump-results", name)
        (written,) = (path for path in (valid / "made" / "result-files").rglob(f"{name}/*") if path.is_file())
        written.rename(valid / f"{name}{written.suffix}")
    shutil.rmtree(valid / "made" / "runs")
    _by_command(valid, "drive", "--split", "val", "--model", "stop", "--agents", "idm")
    (valid / "made" / "drives").rename(valid / "drives")
    write_verdicts(valid)
    _by_command(valid, "generate", *arguments("$SEARCH"), "--freeze", "frozen.json")
    (valid / "made" / "data" / "root" / "adv").rename(valid / "generated")
    write_exchanged(valid)
    shutil.rmtree(valid / "generated" / ".challenger")
    shutil.rmtree(valid / "made")
    (valid / "complete").touch()
    return valid


def write_recorded(root: Path) -> None:
    """A data set of one scene, with maps, CAN bus and pictures."""
    scene = scene_on_straight_road(_CARS, seconds=8.0)
    write_root(root, [scene], version=VERSION, renderer=SchematicRenderer(64, 36), frames="keyframes")
    shutil.rmtree(root / ".challenger")


def write_verdicts(folder: Path) -> None:
    """What somebody says of the scene of the root, in both forms, beside a root of its own."""
    reviewed = folder / "reviewed"
    shutil.copytree(folder / "root", reviewed / "root", ignore=shutil.ignore_patterns("*.jpg"))
    (scene,) = json.loads((reviewed / "root" / VERSION / "scene.json").read_text())
    verdict = {"verdict": "rejected", "reason": "a car stands in another", "inspector": "somebody"}
    (reviewed / "said.json").write_text(json.dumps({scene["name"]: verdict}, indent=1))
    (reviewed / "said.csv").write_text(f"scene,verdict,reason\n{scene['name']},accept,looks right\n")
    shutil.copytree(reviewed / "root", folder / "judged")
    _run_command(folder, "data", "review", "judged", "--verdicts", "reviewed/said.csv")


def write_weights(folder: Path) -> None:
    """Checkpoints in both forms of PyTorch, a denoiser in all, the packaged weights of a planner, motion anchors."""
    import torch

    from adapters import planners as baselines
    from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, load_denoiser

    state = {MOTION_ANCHORS.replace("anchors", "other"): torch.arange(16.0), "b": torch.ones(3, 2, dtype=torch.half)}
    content = {"meta": {"config": "a = 1", "epoch": 6}, "state_dict": state, "optimizer": {"state": {}}}
    torch.save(content, folder / "tensors.pth")
    torch.save(content, folder / "old.pth", _use_new_zipfile_serialization=False)
    torch.save(load_denoiser(PACKAGED_WEIGHTS).state_dict(), folder / "denoiser.ckpt")
    shutil.copy(PACKAGED_WEIGHTS, folder / "denoiser.safetensors")
    packaged = Path(baselines.__file__).parents[1] / "weights"
    shutil.copy(packaged / "ego_status.safetensors", folder / "planner.safetensors")
    shutil.copy(packaged / "vad-mini.safetensors", folder / "network.safetensors")
    rng = np.random.default_rng(0)
    anchors = {"anchors_all": [rng.normal(size=(6, 12, 2)) for _ in range(4)], "grouped": [[0], [1], [2], [3]]}
    (folder / "anchors.pkl").write_bytes(pickle.dumps(anchors))


def write_plans(folder: Path) -> None:
    """A plan for every sample, in every form that is read."""
    import pandas as pd

    samples = json.loads((folder / "root" / VERSION / "sample.json").read_text())
    straight: dict[str, Any] = {}
    for step in range(1, 7):
        straight |= {f"x{step}": 0.0, f"y{step}": 2.5 * step}
    rows = [{"sample_token": row["token"], "frame": "lidar", **straight} for row in samples]
    pd.DataFrame(rows).to_csv(folder / "plans.csv", index=False)
    pd.DataFrame(rows).to_json(folder / "plans.json", orient="records")


def write_exchanged(valid: Path) -> None:
    """What strangers exchange: rules of a challenge, a package, and a scene edited in ScenarioNet's form."""
    # What is generated here has no pictures.
    rules = _run_command(valid, "challenge", "rules").replace("required = true", "required = false")
    (valid / "rules.toml").write_text(rules)
    given = ("--root", "generated", "--rules", "rules.toml", "--to", "package.zip")
    _run_command(valid, "data", "pack", "frozen.json", *given)
    _run_command(valid, "data", "export", "scenarionet", "root", "--to", "exported")
    (exported,) = (valid / "exported").glob("sd_*.pkl")
    # This command's own file.
    scene = pickle.loads(exported.read_bytes())  # noqa: S301
    moved = next(track for name, track in scene["tracks"].items() if name != scene["metadata"]["sdc_id"])
    position = moved["state"]["position"]
    position[:, 1] += 1.5 * np.clip(np.linspace(-1.0, 1.0, len(position)), 0.0, 1.0) ** 2
    (valid / "edited").mkdir()
    (valid / "edited" / exported.name).write_bytes(pickle.dumps(scene))
    shutil.rmtree(valid / "exported")


def _by_command(valid: Path, command: str, *more: str) -> None:
    given = ("--data", str(valid / "root"), "--out", str(valid / "made"), "--workers", "1")
    _run_command(valid, command, *given, *more)


def _run_command(valid: Path, *words: str) -> str:
    """Run a command in the folder of valid files, and say what it printed."""
    ended = run_command(words, valid)
    if ended.code:
        raise InputError(f"{words[0]} failed on what is valid: {ended.err.strip()}; mend it first")
    return ended.out
