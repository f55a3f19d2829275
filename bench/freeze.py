"""Whether the present tree does what another did: both run on this machine, and what they print and write is compared.

Run as ``python bench/freeze.py --start WORKTREE --quick --kept FOLDER``, where WORKTREE is a clean git worktree of the
commit to compare with (``git worktree add ../start COMMIT``). Only the command line of either tree is used, as
subprocesses, so modules may be named and cut as they like. The quick freeze takes some three minutes a side; without
``--quick`` there are more scenes, the default search, all splits, the ablation and, with ``--golden FOLDER``, the
golden numbers and the networks' parity sets below that folder. ``--kept FOLDER`` keeps the start's side, so that the
next comparison costs the present side alone; ``--only PART`` runs some parts and what they need.

Every compared thing is a line; exit code 1 if one differs. What is left out and why is said in ``bench/freezing``.
"""

import argparse
import hashlib
import json
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from freezing.parts import ALLOWED, PARTS, Kind, kind_of
from freezing.tree import Seen, Tree

PRESENT = Path(__file__).resolve().parents[1]
_COMPUTE_OR_DRAW = ("numpy", "scipy", "torch", "opencv-python-headless", "pillow", "shapely", "matplotlib", "typer")
"""Packages whose other version makes a kept side worthless."""
_AT_A_TIME = 2
_SHOWN_CHARACTERS = 200


def commit_of(tree: Path) -> str:
    """Commit of a clean worktree; what a changed one printed could not be kept under a commit's name."""
    if subprocess.run(["git", "status", "--porcelain"], cwd=tree, capture_output=True, text=True, check=True).stdout:
        raise SystemExit(f"{tree} has changes that are not committed; --start needs a clean worktree")
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=tree, capture_output=True, text=True, check=True)
    return head.stdout.strip()


def kept_name(start: Path, kind: Kind) -> str:
    """Under what a start's side is kept: its commit, how much is run, and what else it depends on."""
    text = "".join(path.read_text() for path in sorted((Path(__file__).parent / "freezing").glob("*.py")))
    versions = {}
    for package in _COMPUTE_OR_DRAW:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "none"
    depends = json.dumps([text, versions, platform.python_version(), str(kind.golden)])
    return f"{commit_of(start)[:12]}-{kind.name}-{hashlib.sha256(depends.encode()).hexdigest()[:8]}"


def needs_of(name: str, *, start: bool) -> tuple[str, ...]:
    """What must have run in the same tree before a part."""
    return (*PARTS[name].needs, *(PARTS[name].of_start if start else ()))


def wanted_parts(only: Iterable[str], *, start: bool) -> list[str]:
    """Parts to run, each behind what it needs: those asked for and their needs."""
    wanted = set(only)
    ordered: list[str] = []
    while more := {need for name in wanted for need in needs_of(name, start=start)} - wanted:
        wanted |= more
    while len(ordered) < len(wanted):
        ready = (n for n in PARTS if n in wanted - {*ordered} and {*needs_of(n, start=start)} <= {*ordered})
        ordered.append(next(ready))
    return ordered


def processor_seconds() -> float:
    """What finished subprocesses took of all processors; other work on the machine does not change it."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_side(tree: Tree, kind: Kind, parts: list[str], kept: Path | None = None) -> Seen:
    """Run parts in a tree, two at a time, but for those whose outcome is kept."""
    tree.check()
    side_began, used_before = time.monotonic(), processor_seconds()
    running: dict[str, Future[Seen]] = {}

    def outcome(name: str, needs: list[Future[Seen]]) -> Seen:
        for need in needs:
            need.result()
        file = kept / f"{name}.json" if kept else None
        if file is not None and file.exists():
            found: Seen = json.loads(file.read_text())
            return found
        began, own = time.monotonic(), replace(tree, seen={})
        PARTS[name].run(own, kind)
        print(f"{tree.name}: {name} took {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
        if file is not None:
            file.write_text(json.dumps(own.seen))
        return own.seen

    # Every part is submitted behind its needs, so one that waits waits for a part that runs.
    with ThreadPoolExecutor(_AT_A_TIME) as pool:
        for name in parts:
            needs = [running[need] for need in needs_of(name, start=tree.code_is_start) if need in running]
            running[name] = pool.submit(outcome, name, needs)
    print(
        f"{tree.name}: {time.monotonic() - side_began:.0f} s, of processors {processor_seconds() - used_before:.0f} s",
        file=sys.stderr,
        flush=True,
    )
    return {thing: found for name in PARTS if name in running for thing, found in running[name].result().items()}


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


def report(old: Seen, new: Seen, shown: set[str]) -> bool:
    """Print a line for each thing; whether all are equal that must be."""
    sound = True
    for thing in dict.fromkeys([*old, *new]):
        if thing not in shown:
            continue
        before, after = old.get(thing, {}), new.get(thing, {})
        paths = dict.fromkeys([*before, *after])
        differing = [path for path in paths if before.get(path) != after.get(path)]
        if not differing:
            print(f"equal    {thing} ({len(paths)})")
            continue
        allowed = thing == ALLOWED
        sound &= allowed
        first = differing[0]
        print(
            f"{'changed ' if allowed else 'differs '} {thing}: {len(differing)} of {len(paths)}, first {first}"
            f"{first_difference(before.get(first), after.get(first))}"
        )
    return sound


def compare(start: Path, kind: Kind, only: list[str], kept: Path | None, folder: Path) -> bool:
    """Run both sides and print what differs."""
    start_folder = (kept / kept_name(start, kind) if kept else folder / "start").resolve()
    start_folder.mkdir(parents=True, exist_ok=True)
    work = start_folder / "work"
    old = run_side(Tree("start", start, work, work), kind, wanted_parts(only, start=True), start_folder)
    present = Tree("present", PRESENT, (folder / "present").resolve(), work)
    new = run_side(present, kind, wanted_parts(only, start=False))
    sound = report(old, new, set(new))
    if not sound:
        print(f"the start's files: {work}\nthe present's:     {present.work}")
    return sound


def main() -> None:
    """Compare, and say what differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--start", type=Path, help="clean worktree of the commit to compare with")
    parser.add_argument("--quick", action="store_true", help="2 scenes, 64 candidates, built-in golden numbers")
    parser.add_argument("--kept", type=Path, help="folder outside the repository that keeps the start's side")
    parser.add_argument("--golden", type=Path, help="folder of golden numbers, for the whole freeze")
    parser.add_argument("--only", nargs="+", choices=list(PARTS), metavar="PART", help=f"of {', '.join(PARTS)}")
    given = parser.parse_args()
    if given.start is None:
        print("nothing is compared without --start, a worktree of the commit to compare with (--help says more)")
        return
    if given.quick and given.golden is not None:
        parser.error("--golden belongs to the whole freeze")
    golden = None if given.golden is None else given.golden.resolve()
    kind = kind_of(quick=given.quick, golden=golden)
    folder = Path(tempfile.mkdtemp(prefix="freeze-"))
    sound = compare(given.start.resolve(), kind, given.only or list(PARTS), given.kept, folder)
    if sound:
        shutil.rmtree(folder)
    sys.exit(0 if sound else 1)


if __name__ == "__main__":
    main()
