"""The direction of imports that keeps the four packages apart."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {
    "benchmark": {"benchmark"},
    "generation": {"benchmark", "generation"},
    "adapters": {"benchmark", "adapters"},
    "leaderboard": {"benchmark", "leaderboard"},
}
LEADERBOARD_MAY_READ = {
    "benchmark.records",
    "benchmark.quality.records",
    "benchmark.sheets.records",
    "benchmark.ablation_records",
    "benchmark.published",
    "benchmark.rates",
    "benchmark.transfer",
    "benchmark.scores",
    "benchmark.significance",
    "benchmark.confusion",
    "benchmark.labels",
    "benchmark.storage",
    "benchmark.errors",
    "benchmark.constants",
    "benchmark.geometry",
    "benchmark.waypoints",
}


def imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add(node.module or "")
    return names


@pytest.mark.parametrize("package", ALLOWED)
def test_packages_import_in_one_direction(package: str) -> None:
    files = [path for path in (ROOT / package).rglob("*.py") if path != ROOT / "benchmark/cli.py"]
    assert files
    for path in files:
        ours = {name.split(".")[0] for name in imports(path)} & set(ALLOWED)
        assert ours <= ALLOWED[package], path


def test_leaderboard_reads_records_only() -> None:
    for path in (ROOT / "leaderboard").rglob("*.py"):
        ours = {name for name in imports(path) if name.startswith("benchmark")}
        assert ours <= LEADERBOARD_MAY_READ, path


def test_help_does_not_import_the_heavy_packages() -> None:
    tree = ast.parse((ROOT / "benchmark/cli.py").read_text())
    top = {
        (node.module or "") if isinstance(node, ast.ImportFrom) else alias.name
        for node in tree.body
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }
    assert not {name.split(".")[0] for name in top} & {"torch", "numpy", "generation", "adapters", "leaderboard"}
