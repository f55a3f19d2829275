"""What a reader of exported infos needs: images for networks alone, times that tell scenes apart; names of splits."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.extensions.infos.exporting import InfoSettings, build_info_files, export_infos
from benchmark.extensions.infos.repositories import REPOSITORIES
from generation.nuscenes_writer.plan import SourceInfo
from tests.benchmark.cli.cli_runs import refusal, run_main
from tests.benchmark.extensions.infos.info_roots import SECONDS, exported, plain_root, read, scene_names, variant_root
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root


@pytest.fixture(scope="module")
def variants(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return variant_root(tmp_path_factory.mktemp("variants") / "root", frames="keyframes")


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return plain_root(tmp_path_factory.mktemp("plain") / "root", frames="keyframes")


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes at the same time, as variants of one recording were written."""
    root = tmp_path_factory.mktemp("twins") / "root"
    first, second = (short_scene(name, seconds=SECONDS) for name in ("scene-9901", "scene-9902"))
    write_root(root, [first, replace(second, timestamps_us=first.timestamps_us)], frames="keyframes")
    return root


@pytest.mark.path
def test_the_official_metric_takes_what_converters_write(tmp_path: Path) -> None:
    root = plain_root(tmp_path / "root", "scene-9901", "scene-0061", frames="keyframes")
    export_infos(root, tmp_path / "to", InfoSettings("sparsedrive"))
    done = export_infos(root, tmp_path / "to", InfoSettings("sparsedrive", as_converted=True))
    assert any("in the train file" in said for said in done.unrepaired)
    assert not (tmp_path / "to" / "sparsedrive_departures.json").exists()
    # As the configuration finds them: `data/nuscenes` is the folder beside the infos.
    (tmp_path / "data").symlink_to(tmp_path / "to")
    infos = read(tmp_path / "to" / "nuscenes_infos_val.pkl")
    assert all((tmp_path / info["cams"]["CAM_BACK"]["data_path"]).is_file() for info in infos)
    assert count_future_boxes(infos) == [min(6, 8 - at) for at in range(9)]


def test_scenes_of_one_time_are_not_exported_as_converted(twins: Path, tmp_path: Path) -> None:
    words = ("data", "export", "infos", twins, "--for", "sparsedrive", "--split", "val", "--to", tmp_path / "to")
    said = refusal(*words, "--as-converted")
    assert said.startswith("scene-9901 and scene-9902 have the same time")
    assert said.endswith(f"run it without --as-converted: challenger-bench {' '.join(map(str, words))}")
    assert not (tmp_path / "to").exists()
    with pytest.raises(InputError, match=r"run it without --as-converted$"):
        export_infos(twins, tmp_path / "to", InfoSettings("vad", as_converted=True))
    infos = build_info_files(twins, REPOSITORIES["sparsedrive"], InfoSettings("sparsedrive", as_converted=True))
    with pytest.raises(IndexError):
        count_future_boxes(infos.parts["val"])
    assert run_main(*words).code == 0
    assert len(count_future_boxes(read(tmp_path / "to" / "nuscenes_infos_val.pkl"))) == 18


def count_future_boxes(infos: list[dict[str, Any]]) -> list[int]:
    """How many later samples SparseDrive's planning metric takes boxes of, by its reader's rule re-stated.

    Infos are sorted by time; the next six are taken until the scene ends, and one is indexed for every step that the
    recorded future has.
    """
    infos = sorted(infos, key=lambda info: int(info["timestamp"]))
    counts = []
    for at, info in enumerate(infos):
        boxes = []
        for later in infos[at + 1 : at + 7]:
            if later["scene_token"] != info["scene_token"]:
                break
            boxes.append(later["gt_boxes"])
        counts.append(len([boxes[step] for step in range(int(info["gt_ego_fut_masks"].sum()))]))
    return counts


@pytest.mark.path
def test_images_matter_to_networks_alone(variants: Path, tmp_path: Path) -> None:
    said = export_infos(variants, tmp_path, InfoSettings("sparsedrive")).unrepaired
    (warning,) = [sentence for sentence in said if "32x18" in sentence]
    assert "would see black" in warning and "--size 1600x900" in warning and "--image-size 1600x900" in warning
    quiet = export_infos(variants, tmp_path, InfoSettings("sparsedrive", planning_only=True)).unrepaired
    assert set(said) - set(quiet) == {warning}


@pytest.mark.parametrize("repository", list(REPOSITORIES))
def test_roots_without_images_have_infos_without_cameras(plain: Path, tmp_path: Path, repository: Any) -> None:
    bare = plain_root(tmp_path / "root", renderer=None, frames="keyframes")
    infos, drawn = exported(bare, tmp_path / "bare", repository), exported(plain, tmp_path / "drawn", repository)
    assert len(infos) == 9 and all(info["cams"] == {} for info in infos)
    for key in set(infos[3]) & {"gt_boxes", "gt_velocity", "gt_ego_fut_trajs", "gt_agent_fut_trajs", "fut_traj"}:
        np.testing.assert_array_equal(infos[3][key], drawn[3][key], err_msg=key)
    said = export_infos(bare, tmp_path / "bare", InfoSettings(repository)).unrepaired
    assert sum("1 scene has no images" in sentence for sentence in said) == 1
    quiet = export_infos(bare, tmp_path / "bare", InfoSettings(repository, planning_only=True)).unrepaired
    assert len(quiet) == len(said) - 1


def test_only_networks_open_the_files_of_images(plain: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(plain, tmp_path / "root"))
    next(root.glob("samples/CAM_BACK/*")).unlink()
    with pytest.raises(InputError, match="or add --planning-only"):
        export_infos(root, tmp_path / "to", InfoSettings("vad"))
    assert len(exported(root, tmp_path / "to", "vad", planning_only=True)) == 9


def test_a_generated_split_is_found_below_out(plain: Path, tmp_path: Path) -> None:
    out, source = tmp_path / "out", open_data(plain)
    made = variant_root(
        out / "data" / "root" / "adv", frames="keyframes", source=SourceInfo(source.name, source.fingerprint())
    )
    words = ("data", "export", "infos", plain, "--for", "uniad", "--to", tmp_path / "to", "--out", out)
    run = run_main(*words, "--split", "adv")
    assert run.code == 0, run.err
    infos = read(tmp_path / "to" / "nuscenes_infos_temporal_val.pkl")
    assert {info["scene_token"] for info in infos} == set(scene_names(made))
    run = run_main(*words[:-4], "--to", tmp_path / "no", "--out", tmp_path / "other", "--split", "adv")
    assert run.code == 2 and "generate --data" in run.err and not (tmp_path / "no").exists()
