"""The devkit is imported without what only its drawing needs, and draws when asked."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.hand_made import scene_on_straight_road

ROOT = Path(__file__).parents[3]
HEAVY = ("torch", "sklearn", "scipy", "pandas", "matplotlib.pyplot", "matplotlib.axes")

EVALUATED = """
import json, sys
sys.argv = ["challenger-bench", "eval", "--model", "constant-velocity", "--data", {root!r}, "--out", {out!r},
            "--workers", "1", "--json"]
from benchmark.cli.app import main
try:
    main()
except SystemExit as end:
    loaded = [name for name in {heavy!r} if name in sys.modules]
    print(json.dumps({{"code": end.code, "loaded": loaded}}), file=sys.stderr)
"""
DRAWN = """
import sys
from benchmark.datasets.devkit_import import import_devkit_module
devkit = import_devkit_module("nuscenes.nuscenes")
drawing = sys.modules["nuscenes.lidarseg.lidarseg_utils"]
assert not {"sklearn", "matplotlib"} & set(sys.modules)
assert devkit.sklearn.metrics.pairwise.euclidean_distances([[0.0, 1.0]], [[1.0, 1.0]]).tolist() == [[1.0]]
devkit.rcParams["font.family"] = "monospace"
import matplotlib.axes
assert matplotlib.rcParams["font.family"] == ["monospace"]
figure = devkit.plt.figure(figsize=(0.2, 0.2), dpi=100)
figure.add_axes(drawing.plt.Axes(figure, [0.0, 0.0, 1.0, 1.0])).add_patch(
    drawing.mpatches.Rectangle((0, 0), 1, 1, fc=(1, 0, 0)))
canvas = drawing.FigureCanvas(figure)
canvas.draw()
assert canvas.get_width_height() == (20, 20)
import sklearn, nuscenes.eval
assert type(matplotlib.axes).__name__ == type(sklearn).__name__ == "module"
print(matplotlib.axes.Axes.__name__)
"""


def _python(program: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", **environment}, text=True,
        capture_output=True, check=True,
    )  # fmt: skip


def test_evaluating_a_baseline_imports_no_heavy_package(tmp_path: Path) -> None:
    root = TinyRoot.of(tmp_path / "root", [scene_on_straight_road()]).write()
    program = EVALUATED.format(root=str(root), out=str(tmp_path / "out"), heavy=HEAVY)
    said = json.loads(_python(program).stderr.strip().splitlines()[-1])
    assert said == {"code": 0, "loaded": []}


def test_the_devkit_draws_with_the_real_packages() -> None:
    assert _python(DRAWN).stdout == "Axes\n"


def test_torch_imported_after_the_limit_uses_one_thread() -> None:
    program = (
        "from benchmark.machine.workers import single_threaded; single_threaded(); import torch; "
        "print(torch.get_num_threads())"
    )
    assert _python(program, OMP_NUM_THREADS="4", MKL_NUM_THREADS="4").stdout == "1\n"
