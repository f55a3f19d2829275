"""Speed: `python -m bench.speed [NAME ...]` measures the cases of one table, each in a process of its own.

A name stands for a case (`protocols/uniad`) or for all cases of a subject (`protocols`). What a case measures is ours
and, in the same run and in turns, a slow reference or whatever else stands beside it; seconds are of processors unless
the case says otherwise. `--against WORKTREE` measures the same in another commit, in turns.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.speed.case import Case, format_line, measure
from bench.speed.cases import CASES

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = (
    f"import sys, bench\nbench.__path__.insert(0, {str(ROOT / 'bench')!r})\n"
    "from bench.speed.__main__ import in_this_process\nin_this_process(*sys.argv[1:])"
)
"""Cases are those of this tree, what they measure is the other's."""


def in_this_process(name: str, folder: str, quick: str, repeat: str) -> None:
    """Measure a case and print its figures."""
    (case,) = (candidate for candidate in CASES if candidate.name == name)
    with tempfile.TemporaryDirectory(dir=folder or None) as place:
        figures = measure(case, Path(place), quick=quick == "quick", repeat=int(repeat))
    print(json.dumps(figures))


def measure_in_tree(tree: Path, case: Case, given: argparse.Namespace) -> dict[str, Any]:
    """Figures of a case, in a process of its own; or why there are none."""
    words = [case.name, given.folder or "", "quick" if given.quick else "", str(given.repeat)]
    environment = {"OMP_NUM_THREADS": "1", **os.environ, "PYTHONPATH": str(tree)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words], cwd=tree, env=environment, text=True, capture_output=True, check=False
    )
    if done.returncode:
        return {"name": case.name, "failed": (done.stderr.strip().splitlines() or ["without a word"])[-1]}
    figures: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return figures


def figures_of(case: Case, given: argparse.Namespace) -> dict[str, Any]:
    """Figures of a case; with those of the other tree, if one is given."""
    if (why := case.missing()) is not None:
        return {"name": case.name, "skipped": why}
    here = measure_in_tree(ROOT, case, given)
    if given.against is None or "failed" in here:
        return here
    there, again = measure_in_tree(given.against.resolve(), case, given), measure_in_tree(ROOT, case, given)
    if "failed" in there:
        return here | {"wrong": [*here["wrong"], f"not measured in the other tree: {there['failed']}"]}
    here |= {"ours_s": min(here["ours_s"], again.get("ours_s", here["ours_s"])), "there_s": there["ours_s"]}
    if here.get("digest") != there.get("digest"):
        here["wrong"].append("the other tree comes to something else")
    return here


def line(figures: dict[str, Any]) -> str:
    """For people."""
    for key, word in (("skipped", "skipped"), ("failed", "FAILED")):
        if key in figures:
            return f"{figures['name']:<32} {word}: {figures[key]}"
    return format_line(figures)


def main(arguments: Sequence[str] | None = None, cases: tuple[Case, ...] = CASES) -> int:
    """Measure; 1 if a case failed, came to something else or is past what is meant, 2 for an unknown name."""
    parser = argparse.ArgumentParser(prog="python -m bench.speed", description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="cases or subjects; all that need no request if none")
    parser.add_argument("--repeat", type=int, default=3, help="turns; the least time counts")
    parser.add_argument("--quick", action="store_true", help="small sizes, to see that it works")
    parser.add_argument("--json", action="store_true", help="figures as JSON, a line for each case")
    parser.add_argument("--list", action="store_true", help="fitted")
    parser.add_argument("--against", type=Path, help="worktree of another commit, to compare with")
    parser.add_argument("--folder", help="where there is room; what is written there is removed again")
    given = parser.parse_args(arguments)
    known = {case.name for case in cases} | {case.name.partition("/")[0] for case in cases}
    if unknown := [name for name in given.names if name not in known]:
        print(f"there is no case {unknown[0]!r}; python -m bench.speed --list says what there is", file=sys.stderr)
        return 2
    chosen = [
        case
        for case in cases
        if {case.name, case.name.partition("/")[0]} & set(given.names) or not (given.names or case.on_request)
    ]
    if given.list:
        print("\n".join(f"{case.name:<32} {case.measures}" for case in chosen))
        return 0
    sound = True
    for case in chosen:
        figures = figures_of(case, given)
        sound &= "failed" not in figures and not figures.get("wrong")
        print(json.dumps(figures) if given.json else line(figures), flush=True)
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
