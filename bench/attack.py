"""Attack every reader of foreign files, and every other door: options, planners of others, answers of model servers.

Run as ``make attack``, or ``python bench/attack.py --seed 1 --count 1000 --folder attack``: half of the variants are
hostile variants of valid files, half are absurd command lines, side by side in two processes. The same seed makes the
same variants; the same command goes on where it was broken off, from the list of results in the folder. Each variant
runs in a process of its own, and is fine if the command answers it with exit code 2 and one sentence that names the
path, or finds in it what it finds in the valid file, or the variant is a valid file with another content. Anything else
fell, is listed with the command that repeats it, and makes the exit code 1. Requests to our own server stand behind all
command lines (``--doors --kind "requests to our server"``). ``docs/studies/attacks.md`` has figures.
"""

import argparse
import gc
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.attacking.campaign import RESULTS, Attempts, Campaign, Result, known_results, run_campaign
from bench.attacking.doors import DOORS, DoorCampaign
from bench.attacking.targets import TARGETS
from bench.attacking.verdicts import FALLEN, FINE

_RESULT_NAMES = {"files": RESULTS, "doors": DOORS}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000, help="variants of the campaign, or of each with --kind")
    parser.add_argument(
        "--folder", type=Path, default=Path("challenger-out") / "attack", help="valid files and results"
    )
    parser.add_argument("--only", type=int, action="append", help="run this variant again; may be repeated")
    parser.add_argument("--kind", action="append", help="only kinds whose name holds this; may be repeated")
    parser.add_argument("--files", action="store_true", help="files only")
    parser.add_argument("--doors", action="store_true", help="options, planners and model servers only")
    options = parser.parse_args()
    if options.only and not options.doors:
        options.files = True
    if not options.files and not options.doors:
        results = run_in_two_processes(options)
    else:
        given = options.folder, options.seed
        campaign: Attempts = DoorCampaign(*given) if options.doors else Campaign(*given)
        # A child that collects garbage would copy every page that it shares with this process.
        gc.freeze()
        wanted, kinds = options.kind or [""], enumerate(campaign.kinds(options.count))
        numbers = [number for number, kind in kinds if any(word in kind for word in wanted)][: options.count]
        results = list(run_campaign(campaign, options.only or numbers, again=bool(options.only)))
    print(table(results))
    for result in results:
        if result.verdict in FALLEN or options.only:
            print(f"\n{result.verdict}: {result.kind}, {result.command}: {result.name}")
            print(f"  exit code {result.code}, {result.cpu_s} s of processor time, {result.peak_mb} MB")
            print(f"  {result.said or 'said nothing'}")
            what = "--files" if result.kind in {target.kind for target in TARGETS} else "--doors"
            print(f"  again: python bench/attack.py {what} --seed {options.seed} --only {result.number}")
    sys.exit(any(result.verdict in FALLEN for result in results))


def run_in_two_processes(options: argparse.Namespace) -> list[Result]:
    """Half of the variants are of files, half of doors, each in a process and a folder of its own, side by side."""
    kept = {what: options.folder / what / name.format(seed=options.seed) for what, name in _RESULT_NAMES.items()}
    again = ["--seed", str(options.seed), "--count", str(-(-options.count // 2))]
    again += [word for kind in options.kind or () for word in ("--kind", kind)]
    commands = [
        [sys.executable, __file__, f"--{what}", "--folder", f"{path.parent}", *again] for what, path in kept.items()
    ]
    children = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for command in commands]
    broken = [child.wait() not in (0, 1) for child in children]
    if any(broken):
        sys.exit(f"a campaign did not end well; see above, and what is in {options.folder}")
    return [result for path in kept.values() for result in known_results(path).values()]


def table(results: Sequence[Result]) -> str:
    """A row a kind: how many were tried, what was fine, and what fell how."""
    lines = ["| attacked | tried | " + " | ".join(FINE[:3]) + " | fell |", "|---|--:|--:|--:|--:|---|"]
    kinds = list(dict.fromkeys(result.kind for result in results))
    for kind in (*kinds, ""):
        mine = Counter(result.verdict for result in results if kind in ("", result.kind))
        fell = ", ".join(f"{mine[outcome]} {outcome}" for outcome in FALLEN if mine[outcome]) or "0"
        fine = " | ".join(str(mine[outcome]) for outcome in FINE[:3])
        lines.append(f"| {kind or 'all'} | {mine.total()} | {fine} | {fell} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
