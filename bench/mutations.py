"""Which seeded faults the tests notice: the same faults in five rooms of the core, before and after a change of tests.

python bench/mutations.py --out after.json                            # in the tree of now
python bench/mutations.py --out before.json --missed-in after.json    # in the tree of before: what it catches of these

Each fault changes one operator, comparison or number of a function. The room's tests run on a copy of the tree until
the first failure, those that name the changed module first; a run over the time limit counts as caught. With
`--missed-in` the exit code is 1 if a fault that the other run missed is caught here. A run that was stopped goes on
where it was.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = {
    "benchmark/protocols": ["tests/benchmark/protocols", "tests/benchmark/test_evaluation.py"],
    "benchmark/metrics": ["tests/benchmark/metrics", "tests/leaderboard/tables"],
    "benchmark/closed_loop": ["tests/benchmark/closed_loop"],
    "benchmark/records": ["tests/benchmark/records", "tests/benchmark/metrics"],
    "generation/search": ["tests/generation/search"],
}
"""Mutated folder to the tests that run."""
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


@dataclass(frozen=True)
class Fault:
    """One changed node: the number of the node in a walk through the file names it."""

    path: str
    line: int
    node: int
    before: str
    after: str


def faults_of(path: Path) -> Iterator[Fault]:
    """Possible faults inside the functions of a file."""
    tree = ast.parse(path.read_text())
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        for statement in function.body
        for node in ast.walk(statement)
    }
    for number, node in enumerate(ast.walk(tree)):
        if id(node) in inside and isinstance(node, ast.expr) and (changed := change(node)) is not None:
            yield Fault(str(path.relative_to(ROOT)), node.lineno, number, ast.unparse(node), ast.unparse(changed))


def change(node: ast.expr) -> ast.expr | None:
    """A copy of an expression with a fault, if it can have one."""
    if isinstance(node, ast.BinOp) and type(node.op) in SWAPS:
        return ast.BinOp(node.left, SWAPS[type(node.op)](), node.right)  # type: ignore[arg-type]
    if isinstance(node, ast.BoolOp):
        return ast.BoolOp(SWAPS[type(node.op)](), node.values)  # type: ignore[arg-type]
    if isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
        return ast.Compare(node.left, [SWAPS[type(node.ops[0])](), *node.ops[1:]], node.comparators)  # type: ignore[list-item]
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return ast.Constant(node.value + 1)
    return None


class Planter(ast.NodeTransformer):
    """Replaces one node."""

    def __init__(self, target: ast.AST) -> None:
        self.target = target

    def visit(self, node: ast.AST) -> ast.AST:
        """The changed node in place of the target, everything else as it is."""
        if node is self.target:
            assert isinstance(node, ast.expr)
            changed = change(node)
            assert changed is not None
            return ast.copy_location(changed, node)
        return self.generic_visit(node)


def plant(fault: Fault, tree: Path) -> str:
    """Write the file with a fault; returns its text of before."""
    path = tree / fault.path
    text = path.read_text()
    parsed = ast.parse(text)
    target = list(ast.walk(parsed))[fault.node]
    if ast.unparse(target) != fault.before:
        sys.exit(f"{fault.path} is another file in this tree")
    path.write_text(ast.unparse(ast.fix_missing_locations(Planter(target).visit(parsed))))
    return text


def draw(seed: int, count: int) -> list[tuple[str, Fault]]:
    """The same faults for the same code: ``count`` of each room, none twice in a function's line."""
    drawn = []
    for room in ROOMS:
        possible = [fault for path in sorted((ROOT / room).glob("*.py")) for fault in faults_of(path)]
        lines = sorted({(fault.path, fault.line) for fault in possible})
        generator = random.Random(f"{seed} {room}")
        for path, line in sorted(generator.sample(lines, count)):
            drawn.append((room, generator.choice([f for f in possible if (f.path, f.line) == (path, line)])))
    return drawn


def order_tests(room: str, changed: str, tree: Path) -> list[str]:
    """Test modules of a room: those called like the changed module, those that import it, and the others."""
    stem = Path(changed).stem
    module = changed.removesuffix(".py").replace("/", ".")
    paths = [path for name in ROOMS[room] for path in (sorted((tree / name).rglob("test_*.py")) or [tree / name])]
    keys = {path: (stem not in path.stem, module not in path.read_text()) for path in paths}
    return [str(path.relative_to(tree)) for path in sorted(paths, key=lambda path: keys[path])]


def is_caught(tests: list[str], tree: Path, limit_s: float) -> bool:
    """Whether tests fail, or run over the limit."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--part", "core", *tests]
    try:
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        return True
    if done.returncode not in (0, 1, 2, 4):
        sys.exit(f"pytest ended with {done.returncode}: {done.stdout.decode()[-2000:]}")
    return done.returncode != 0


def main() -> None:
    """Plant each fault, run, and write what was caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--missed-in", type=Path, help="the file of another run: the faults that it missed alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=10, help="faults of each room")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds for the tests of a fault")
    parser.add_argument("--room", choices=ROOMS, action="append", help="these alone")
    options = parser.parse_args()
    results = json.loads(options.out.read_text()) if options.out.exists() else []
    known = {(each["path"], each["node"], each["before"]) for each in results}
    if options.missed_in:
        missed = [each for each in json.loads(options.missed_in.read_text()) if not each["caught"]]
        faults = [(each["room"], Fault(*(each[field.name] for field in fields(Fault)))) for each in missed]
    else:
        faults = draw(options.seed, options.count)
    with tempfile.TemporaryDirectory() as temporary:
        tree = Path(temporary) / "tree"
        files = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, files.split("\0")):
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
        for room, fault in faults:
            if (fault.path, fault.node, fault.before) in known or room not in (options.room or ROOMS):
                continue
            text, start = plant(fault, tree), time.monotonic()
            caught = is_caught(order_tests(room, fault.path, tree), tree, options.limit)
            (tree / fault.path).write_text(text)
            results.append({"room": room, **asdict(fault), "caught": caught, "seconds": time.monotonic() - start})
            options.out.write_text(json.dumps(results, indent=1))
            print(
                f"{'caught' if caught else 'MISSED'} {fault.path}:{fault.line}: {fault.before} -> {fault.after}",
                flush=True,
            )
    for room in ROOMS:
        of_room = [each["caught"] for each in results if each["room"] == room]
        print(f"{room}: {sum(of_room)} of {len(of_room)} caught")
    if options.missed_in:
        caught_here = [each for each in results if each["caught"]]
        for each in caught_here:
            print(f"caught here alone: {each['path']}:{each['line']}: {each['before']} -> {each['after']}")
        sys.exit(bool(caught_here))


if __name__ == "__main__":
    main()
