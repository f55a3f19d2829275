"""A server whose answers are in other axes is told so, by what would fit."""

import json
from pathlib import Path

import pytest

from benchmark.records.drives import load_drives
from generation.sources.mini import TownSettings, build_town_data_set
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.http.made import scripted


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some scenes of mini with small pictures."""
    settings = TownSettings(val_scenes=4, width=96, height=54, frames="keyframes")
    return build_town_data_set(tmp_path_factory.mktemp("town") / "root", settings, workers=1)


def test_a_server_in_axes_of_the_lidar_is_named_and_driven_right_with_its_frame(root: Path, tmp_path: Path) -> None:
    """As the fork of VAD that serves NeuroNCAP answers: x right, y forward."""

    def ahead(path: str, body: bytes) -> tuple[int, bytes]:
        if path != "/infer":
            return 200, b"true"
        speed = json.loads(body)["canbus"][13]
        return 200, json.dumps(
            {"trajectory": [[0.0, 0.5 * step * speed] for step in range(1, 7)], "aux_outputs": {}}
        ).encode()

    options = ("--data", root, "--split", "val", "--workers", "1", "--image-format", "png")
    driving = ("--sensor", "schematic", "--no-baselines")
    with scripted(ahead) as server:
        asked = ("--model", f"fork={server.url}")
        wrong = run_here("drive", *asked, *driving, *options, "--out", tmp_path / "wrong")
        right = run_here("drive", *asked, *driving, *options, "--out", tmp_path / "right", "--frame", "lidar")
        planned = run_here("eval", *asked, *options, "--out", tmp_path / "planned")
        read = run_here("eval", *asked, *options, "--out", tmp_path / "read", "--frame", "lidar")
    for done in (wrong, planned):
        assert done.code == 0 and done.err.count("warning:") == 1 and "fork ¶" in done.out
        assert (
            "axes x right, y forward would fit" in done.err and "--frame lidar" in done.err and "NeuroNCAP" in done.err
        )
    for done in (right, read):
        assert done.code == 0 and "warning" not in done.err and "¶" not in done.out
    shares = {
        name: [row.scores.route_share or 0.0 for row in load_drives(path.parent).rows if row.scores]
        for name in ("wrong", "right")
        for path in (tmp_path / name).rglob("drive.json")
    }
    sideways, along = ([share for share in shares[name] if share is not None] for name in ("wrong", "right"))
    assert sideways and along and max(sideways) < 0.1 < min(along)
