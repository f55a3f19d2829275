"""`verify infos`: golden sets of official converters where they are, and sets made here with something wrong."""

import copy
import json
import lzma
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.infos.verification import GOLDEN
from tests.benchmark.extensions.infos.info_roots import Contents, golden_contents, plain_root, write_golden

OFFICIAL = Path(__file__).resolve().parents[5] / "shared" / "golden" / "info_files"
Infos = list[dict[str, Any]]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return plain_root(tmp_path_factory.mktemp("golden") / "straight")


@pytest.fixture(scope="module")
def contents(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Contents:
    return golden_contents(root, tmp_path_factory.mktemp("contents"))


@pytest.fixture(scope="module")
def golden(root: Path, contents: Contents, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sound set of one repository."""
    few = {name: contents[name] for name in ("uniad", "manifest")}
    return write_golden(few, root, tmp_path_factory.mktemp("sound") / "set")


def failed(golden: Path) -> list[str]:
    return [check.quantity for check in GOLDEN.verify(golden) if not check.ok]


@pytest.mark.skipif(not OFFICIAL.is_dir(), reason="the golden set of official converters is not beside the repository")
def test_what_official_converters_wrote(tmp_path: Path) -> None:
    manifest = json.loads((OFFICIAL / "manifest.json").read_text())
    # The odd root has nearly everything that makes a difference, the adversarial one the rest; others take a minute.
    for name, kept in {"town": (), "odd": ("uniad", "vad", "sparsedrive"), "adv": ("vad",), "sn0757": ()}.items():
        files = manifest["roots"][name]["files"]
        manifest["roots"][name]["files"] = {repository: files[repository] for repository in kept}
    del manifest["roots"]["sn0757"]
    for path in OFFICIAL.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    checks = GOLDEN.verify(tmp_path)
    assert [check for check in checks if not check.ok] == [] and len(checks) > 150
    assert next(check for check in checks if check.quantity == "sparsedrive: map_annos").count > 10_000


@pytest.mark.path
def test_a_set_made_here_agrees(contents: Contents, root: Path, tmp_path: Path) -> None:
    assert failed(write_golden(contents, root, tmp_path / "set")) == []


def _added(infos: Infos, key: str, amount: float) -> None:
    """To the whole of an array of one info, in its own precision."""
    infos[2][key] = infos[2][key] + infos[2][key].dtype.type(amount)


def _wrong_uniad(infos: Infos) -> list[str]:
    _added(infos, "gt_boxes", 1e-6)
    _added(infos, "fut_traj", 1e-6)
    _added(infos, "can_bus", 1e-9)
    infos[3]["gt_velocity"] = np.full((3, 2), np.nan)
    infos[4]["frame_idx"] = np.int64(4)
    infos[5]["lidar2ego_translation"][0] += 1e-12
    infos[6]["cams"]["CAM_BACK"]["data_path"] = "./data/nuscenes/elsewhere.jpg"
    infos[6]["cams"]["CAM_FRONT"]["sensor2lidar_rotation"] = np.eye(3)
    infos[7]["token"] = infos[7].pop("token")
    infos[8]["sweeps"].pop()
    return [
        "gt_boxes", "fut_traj", "can_bus", "places of NaN", "frame_idx", "lidar2ego_translation", "cams.*.data_path",
        "cams.*.sensor2lidar_rotation", "keys of an info", "number of sweeps",
    ]  # fmt: skip


def _wrong_vad(infos: Infos) -> list[str]:
    _added(infos, "gt_agent_fut_yaw", 1e-4)
    _added(infos, "gt_ego_lcf_feat", 1e-3)
    infos[3]["gt_ego_fut_cmd"] = np.zeros(3)
    infos[4]["gt_ego_fut_cmd"] = np.array([1, 0, 0], np.float32)
    infos[5]["fut_valid_flag"] = not infos[5]["fut_valid_flag"]
    infos[6]["map_location"] = "singapore-onenorth"
    infos[7], infos[8] = infos[8], infos[7]
    found = ("gt_agent_fut_yaw", "gt_ego_lcf_feat", "gt_ego_fut_cmd", "map_location")
    return [*found, "dtypes and shapes", "order of infos"]


def _wrong_sparsedrive(infos: Infos) -> list[str]:
    infos[2]["map_annos"][1][0][:, 0] += 1e-5
    infos[3]["map_annos"][2].pop()
    infos[4]["map_annos"] = "nonsense"
    infos[5]["instance_inds"] = [2, 1, 0]
    _added(infos, "ego_status", 1e-3)
    return ["map_annos", "elements of map_annos", "classes of map_annos", "instance_inds", "ego_status"]


@pytest.mark.parametrize(
    ("repository", "spoil"), [("uniad", _wrong_uniad), ("vad", _wrong_vad), ("sparsedrive", _wrong_sparsedrive)]
)
def test_each_wrong_value_is_found(
    repository: str, spoil: Callable[[Infos], list[str]], contents: Contents, root: Path, tmp_path: Path
) -> None:
    spoiled = {repository: copy.deepcopy(contents[repository]), "manifest": contents["manifest"]}
    wrong = spoil(spoiled[repository]["infos"])
    found = failed(write_golden(spoiled, root, tmp_path / "set"))
    assert {f"{repository}: {name}" for name in wrong} <= set(found)
    # Infos that stand in each other's place differ in much; elsewhere nothing else is found.
    assert repository == "vad" or len(found) == len(wrong)


def test_other_tables_and_metadata_are_found(contents: Contents, root: Path, tmp_path: Path) -> None:
    changed = {name: copy.deepcopy(contents[name]) for name in ("vad", "manifest")}
    changed["manifest"]["roots"][root.name]["fingerprint"]["sha256"]["sample"] = "0" * 64
    changed["vad"]["metadata"]["version"] = "v1.0-mini"
    found = failed(write_golden(changed, root, tmp_path / "set"))
    assert found == ["tables of the roots", "vad: top level"]


def _manifest(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    def spoil(golden: Path) -> None:
        manifest = json.loads((golden / "manifest.json").read_text())
        change(manifest["roots"]["straight"])
        (golden / "manifest.json").write_text(json.dumps(manifest))

    return spoil


def _holding(data: bytes) -> Callable[[Path], int]:
    return lambda golden: _file(golden).write_bytes(lzma.compress(data))


def _file(golden: Path) -> Path:
    return golden / "files" / "uniad.pkl.xz"


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda golden: _file(golden).write_bytes(_file(golden).read_bytes()[:-200]), "cannot be unpacked"),
        (_holding(b"cposix\ngetcwd\n(tR."), "posix.getcwd"),
        (_holding(b"]."), "golden set of infos"),
        (lambda golden: shutil.rmtree(golden / "tables"), "cannot read"),
        (_manifest(lambda row: row.pop("files")), "golden set of infos"),
        (_manifest(lambda row: row.update(version="../..")), "points outside the set"),
        (_manifest(lambda row: row["files"]["uniad"].update(path="/etc/passwd")), "points outside the set"),
        (_manifest(lambda row: row.update(tables="nowhere")), "does not locate the tables"),
        (_manifest(lambda row: row.update(tables="those of mars")), "golden set of infos"),
    ],
)
def test_a_broken_set_is_refused(spoil: Callable[[Path], Any], says: str, golden: Path, tmp_path: Path) -> None:
    broken = Path(shutil.copytree(golden, tmp_path / "set"))
    spoil(broken)
    with pytest.raises(InputError, match=says) as refused:
        GOLDEN.verify(broken)
    assert "\n" not in str(refused.value)


def test_a_program_that_is_not_known_is_not_run_and_no_set_is_built_in(
    golden: Path, root: Path, tmp_path: Path
) -> None:
    other = Path(shutil.copytree(golden, tmp_path / "set"))
    manifest = json.loads((other / "manifest.json").read_text())
    row = {**manifest["roots"]["straight"], "tables": "those of straight, through make_odd.py"}
    manifest["roots"] = {"odd": {**row, "recipe": "python make_odd.py A B 0"}, **manifest["roots"]}
    (other / "manifest.json").write_text(json.dumps(manifest))
    (other / "make_odd.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    with pytest.raises(InputError, match="needs --golden"):
        GOLDEN.verify()
    with pytest.raises(InputError, match="has no manifest"):
        GOLDEN.verify(tmp_path)
    with pytest.raises(InputError, match=r"differs from the known program and is not run.*tables/odd"):
        GOLDEN.verify(other)
    assert not (tmp_path / "ran").exists()
    # What somebody made by running it is taken as it is.
    shutil.copytree(root, other / "tables" / "odd")
    assert failed(other) == []
