"""Set-up: what of pip's lines a reader sees, and that 6 GB of CUDA are named before they are fetched."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / ".ci" / "install.py"
INSTALL = runpy.run_path(str(SCRIPT))


def environment(folder: Path, lines: str, code: int = 0, report: object = None) -> Path:
    """An environment whose pip prints these lines, or the report that it is asked for, and ends with this code."""
    (folder / "bin").mkdir(parents=True)
    python = folder / "bin" / "python"
    (folder / "lines").write_text(lines)
    (folder / "report").write_text(json.dumps(report))
    python.write_text(
        f'#!/bin/sh\ncase "$*" in *--report*) cat "{folder}/report";; *) echo "$*" >> "{folder}/asked"; '
        f'cat "{folder}/lines"; exit {code};; esac\n'
    )
    python.chmod(0o755)
    return folder


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    called = [sys.executable, str(SCRIPT), *map(str, arguments)]
    return subprocess.run(called, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("  Downloading torch-2.13.0-cp311.whl (190.2 MB)", "  torch-2.13.0-cp311.whl (190 MB)"),
        ("  Downloading nvidia_cudnn.whl (1.2 GB)", "  nvidia_cudnn.whl (1200 MB)"),
        ("Using cached https://index.example/ray-2.54.whl (72.1 MB)", "  ray-2.54.whl (72 MB)"),
        ("  Downloading six-1.17.0.whl (11 kB)", None),
        ("  Downloading tiny.whl (1.1 MB)", None),
        ("Collecting torch==2.13.0", None),
        ("WARNING: Location 'file:///nowhere' is ignored", None),
        ("Installing collected packages: a, b, c", "  unpacking 3 packages"),
        ("ERROR: No matching distribution found", "ERROR: No matching distribution found"),
    ],
)
def test_a_line_of_pip_is_said_where_it_helps(line: str, said: str | None) -> None:
    assert INSTALL["worth_saying"](line) == said


def test_pips_arguments_and_its_exit_code_are_handed_on(tmp_path: Path) -> None:
    place = environment(tmp_path / "env", "Collecting x\nERROR: no space left on device\n", 3)
    ended = run(place, "--constraint", "c.txt", "--editable", ".[dev]")
    assert ended.returncode == 3 and ended.stdout == "ERROR: no space left on device\n"
    assert (place / "asked").read_text().endswith("install --progress-bar off --constraint c.txt --editable .[dev]\n")


@pytest.mark.parametrize(
    ("wanted", "named"), [(["numpy", "nvidia-cublas-cu12==12.8; platform_system == 'Linux'"], True), (["numpy"], False)]
)
def test_cuda_is_named_with_the_way_out_before_it_is_fetched(wanted: list[str], named: bool, tmp_path: Path) -> None:
    if Path("/dev/nvidia0").exists():
        pytest.skip("an NVIDIA GPU is here")
    report = {"install": [{"metadata": {"requires_dist": wanted}}]}
    place = environment(tmp_path / "env", "  Downloading torch.whl (800 MB)\n", 0, report)
    ended = run("--torch-from", "file:///nowhere/whl/cpu", place, "torch")
    before, _, after = ended.stdout.partition("  torch.whl (800 MB)")
    assert ended.returncode == 0 and after.strip() == ""
    assert ("6 GB" in before and "make TORCH_CPU=" in before) is named, before
