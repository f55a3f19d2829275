"""Attack every reader of foreign files: hostile variants of valid files, each given to the command that reads it.

Run as ``make attack``, or ``python bench/attack.py --seed 1 --count 1000 --folder attack``. The same seed makes the
same variants; the same command goes on where it was broken off, from the list of results in the folder. Each variant
runs in a process of its own, and is fine if the command answers it with exit code 2 and one sentence that names the
path, or finds in it what it finds in the valid file, or the variant is a valid file with another content. Anything else
fell, is listed with the command that repeats it, and makes the exit code 1. ``docs/hostile-input.md`` has the figures.
"""

import argparse
import gc
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.attacking.campaign import Campaign, Result, run_campaign
from bench.attacking.doors import Doors
from bench.attacking.targets import TARGETS
from bench.attacking.verdicts import FALLEN, FINE


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=500, help="variants of the campaign")
    parser.add_argument(
        "--folder", type=Path, default=Path("challenger-out") / "attack", help="valid files and results"
    )
    parser.add_argument("--only", type=int, action="append", help="run this variant again; may be repeated")
    parser.add_argument("--kind", help="only kinds whose name holds this")
    parser.add_argument("--doors", action="store_true", help="options and planners instead of files")
    options = parser.parse_args()
    campaign: Campaign | Doors = (Doors if options.doors else Campaign)(options.folder, options.seed)
    # A child that collects garbage would copy every page that it shares with this process.
    gc.freeze()
    if isinstance(campaign, Doors):
        kinds = [tried.kind for tried in campaign.tries[: options.count]]
    else:
        kinds = [TARGETS[number % len(TARGETS)].kind for number in range(options.count)]
    numbers = options.only or [number for number, kind in enumerate(kinds) if (options.kind or "") in kind]
    results = list(run_campaign(campaign, numbers, again=bool(options.only)))
    print(table(results))
    for result in results:
        if result.verdict in FALLEN or options.only:
            print(f"\n{result.verdict}: {result.kind}, {result.command}: {result.name}")
            print(f"  exit code {result.code}, {result.cpu_s} s of processor time, {result.peak_mb} MB")
            print(f"  {result.said or 'said nothing'}")
            doors = " --doors" if options.doors else ""
            print(f"  again: python bench/attack.py{doors} --seed {options.seed} --only {result.number}")
    sys.exit(any(result.verdict in FALLEN for result in results))


def table(results: Sequence[Result]) -> str:
    """A row a kind: how many were tried, what was fine, and what fell how."""
    lines = ["| attacked | tried | " + " | ".join(FINE[:3]) + " | fell |", "|---|--:|--:|--:|--:|---|"]
    kinds = list(dict.fromkeys(result.kind for result in results))
    for kind in (*kinds, ""):
        mine = Counter(result.verdict for result in results if kind in ("", result.kind))
        fell = ", ".join(f"{mine[each]} {each}" for each in FALLEN if mine[each]) or "0"
        fine = " | ".join(str(mine[each]) for each in FINE[:3])
        lines.append(f"| {kind or 'all'} | {mine.total()} | {fine} | {fell} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
