"""Whether the present tree does what another did: both run on this machine, and what they print and write is compared.

Run as ``python bench/freeze.py --start WORKTREE --kept FOLDER``, where WORKTREE is a clean git worktree of the commit
to compare with (``git worktree add ../start COMMIT``). Only the command line of either tree is used, as subprocesses,
so modules may be named and cut as they like. Which commands run is a table, ``freezing/cases.py``; it must have every
command of the app, or a reason why not. ``--quick`` leaves out what takes minutes, ``--only NAME`` runs some cases and
what they read, ``--kept FOLDER`` keeps the start's side, so that the next comparison costs the present side alone.
``--numbers`` compares numbers, keys, names of files and exit codes, and no sentence: for changes of words.

Every case is a line; exit code 1 if one differs.
"""

import argparse
import hashlib
import json
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

PRESENT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(PRESENT))

from bench.freezing.cases import CASES, NOT_FROZEN, in_order, left_out  # noqa: E402 - found beside this file
from bench.freezing.tree import Seen, Tree  # noqa: E402

_COMPUTE_OR_DRAW = ("numpy", "scipy", "torch", "opencv-python-headless", "pillow", "shapely", "matplotlib", "typer")
"""Packages whose other version makes a kept side worthless."""
_AT_A_TIME = 2
_SHOWN_CHARACTERS = 200
OutputsByCase = dict[str, Seen]
"""What was seen, by name of the case."""


def commit_of(tree: Path) -> str:
    """Commit of a clean worktree; what a changed one printed could not be kept under a commit's name."""
    if subprocess.run(["git", "status", "--porcelain"], cwd=tree, capture_output=True, text=True, check=True).stdout:
        raise SystemExit(f"{tree} has changes that are not committed; --start needs a clean worktree")
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=tree, capture_output=True, text=True, check=True)
    return head.stdout.strip()


def cached_name(start: Path, golden: Path | None) -> str:
    """Under what a start's side is kept: its commit, and what else it depends on."""
    text = "".join(path.read_text() for path in sorted((Path(__file__).parent / "freezing").glob("*.py")))
    versions = {}
    for package in _COMPUTE_OR_DRAW:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "none"
    depends = json.dumps([text, versions, platform.python_version(), str(golden)])
    return f"{commit_of(start)[:12]}-{hashlib.sha256(depends.encode()).hexdigest()[:8]}"


def run_side(tree: Tree, names: list[str], kept: Path | None = None) -> OutputsByCase:
    """Run cases in a tree, two at a time, but for those whose outcome is kept."""
    tree.check()
    began, stopped = time.monotonic(), threading.Event()
    running: dict[str, Future[Seen]] = {}

    def outcome(name: str) -> Seen:
        for need in CASES[name].needed(start=tree.code_is_start) & {*running}:
            running[need].result()
        if stopped.is_set():
            raise SystemExit("stopped")
        file = kept / f"{name}.json" if kept else None
        if file is not None and file.exists():
            outputs: Seen = json.loads(file.read_text())
            return outputs
        case_began = time.monotonic()
        try:
            outputs = tree.run(CASES[name])
        except BaseException:
            stopped.set()
            raise
        print(f"{tree.name}: {name} took {time.monotonic() - case_began:.0f} s", file=sys.stderr, flush=True)
        if file is not None:
            file.write_text(json.dumps(outputs))
        return outputs

    # Every case is submitted behind what it reads, so one that waits waits for a case that runs.
    with ThreadPoolExecutor(_AT_A_TIME) as pool:
        for name in names:
            running[name] = pool.submit(outcome, name)
    failed = [error for future in running.values() if (error := future.exception()) and str(error) != "stopped"]
    if failed:
        raise failed[0]
    print(f"{tree.name}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    return {name: running[name].result() for name in names}


def first_difference(old: str | None, new: str | None) -> str:
    """The first line in which two texts differ, or which of them is missing; nothing for two hashes."""
    if old is None or new is None:
        return " (new)" if old is None else " (missing)"
    lines = zip((*old.splitlines(), "the end"), (*new.splitlines(), "the end"), strict=False)
    was, now = next(((a, b) for a, b in lines if a != b), ("", ""))
    if "\n" not in old + new and len(old) == len(new) == 64:
        return ""
    at = max(next((i for i, (a, b) in enumerate(zip(was, now, strict=False)) if a != b), 0) - 40, 0)
    shown = slice(at, at + _SHOWN_CHARACTERS)
    return f"\n    start:   {was[shown].strip()}\n    present: {now[shown].strip()}"


def differences(old: OutputsByCase, new: OutputsByCase, *, numbers: bool = False) -> list[str]:
    """Print a line for each case of the new side; the names of those that differ.

    Args:
        old: The start's side.
        new: The present's.
        numbers: Whether sentences are left out of it.

    Returns:
        Names of cases.
    """
    differing_cases = []
    for name, seen in new.items():
        before = {path: hashes[numbers] for path, hashes in old.get(name, {}).items()}
        after = {path: hashes[numbers] for path, hashes in seen.items()}
        paths = dict.fromkeys([*before, *after])
        differing = [path for path in paths if before.get(path) != after.get(path)]
        if not differing:
            print(f"equal    {name} ({len(paths)})")
            continue
        differing_cases.append(name)
        first = differing[0]
        print(
            f"differs  {name}: {len(differing)} of {len(paths)}, first {first}"
            f"{first_difference(before.get(first), after.get(first))}"
        )
    return differing_cases


def choose_cases(only: list[str] | None, *, quick: bool) -> list[str]:
    """Names of the cases to run; says which are left out because a package is missing."""
    names = only or [name for name, case in CASES.items() if not (quick and case.whole)]
    for name in list(names):
        missing = [package for package in CASES[name].needs if find_spec(package) is None]
        if missing:
            print(f"left out {name}: {missing[0]} is not installed")
            names = [other for other in names if other != name]
    return names


def compare(start: Path, names: list[str], golden: Path | None, kept: Path | None, *, numbers: bool) -> bool:
    """Run both sides and print what differs; whether nothing does."""
    folder = Path(tempfile.mkdtemp(prefix="freeze-"))
    start_folder = (kept / cached_name(start, golden) if kept else folder / "start").resolve()
    work = start_folder / "work"
    work.mkdir(parents=True, exist_ok=True)
    present = Tree("present", PRESENT, (folder / "present").resolve(), work, golden)
    present.check()
    if unexplained := left_out(present.commands()):
        raise SystemExit("\n".join(unexplained))
    old = run_side(Tree("start", start, work, work, golden), in_order(names, start=True), start_folder)
    new = run_side(present, in_order(names, start=False))
    differing = differences(old, new, numbers=numbers)
    if differing:
        print(f"the start's files: {work}\nthe present's:     {present.work}")
    else:
        shutil.rmtree(folder)
    return not differing


def main() -> None:
    """Compare, and say what differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--start", type=Path, help="clean worktree of the commit to compare with")
    parser.add_argument("--quick", action="store_true", help="without the cases that take minutes")
    parser.add_argument("--numbers", action="store_true", help="compare numbers, keys, file names and exit codes alone")
    parser.add_argument("--kept", type=Path, help="folder outside the repository that keeps the start's side")
    parser.add_argument(
        "--golden", type=Path, default=PRESENT.parent / "shared/golden", help="golden sets; the packages' own if none"
    )
    parser.add_argument("--only", nargs="+", choices=list(CASES), metavar="CASE", help=f"of {', '.join(CASES)}")
    given = parser.parse_args()
    if given.start is None:
        print("nothing is compared without --start, a worktree of the commit to compare with (--help says more)")
        for name, why in NOT_FROZEN.items():
            print(f"not frozen: {name}, which {why}")
        return
    golden = given.golden.resolve() if given.golden.is_dir() else None
    names = choose_cases(given.only, quick=given.quick)
    sys.exit(0 if compare(given.start.resolve(), names, golden, given.kept, numbers=given.numbers) else 1)


if __name__ == "__main__":
    main()
