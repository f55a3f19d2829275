"""Kill commands at moments of chance, twice in a row, run them again, and compare every byte that they leave.

Commands that ask a model server go on by themselves where that is killed, and are compared in the same way.

Run as ``nice python bench/kills.py --folder kills``; the same command goes on where it was broken off. What is left is
compared with what an undisturbed command with one worker leaves: every file below ``--out`` and in the user's cache,
hidden ones too, and every folder. What is exempt is printed with its reason. Records name the commit that made them, so
that a series is of one commit, in a checkout that nobody changes while it lasts.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import adapters.extensions.training.ego_status
import benchmark.evaluation
from adapters.extensions.training.ego_status import TrainingSettings
from bench.attacking.campaign import RESULTS, preload
from bench.killing.commands import COMMANDS, KilledCommand
from bench.killing.series import EXEMPT, WAYS, KillBench, Series
from benchmark.errors import InputError
from benchmark.machine.environment import read_source_state


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("challenger-out") / "kills")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--moments", type=int, default=10, help="cases of each command and way")
    parser.add_argument("--command", action="append", choices=list(COMMANDS))
    parser.add_argument("--how", action="append", choices=list(WAYS))
    parser.add_argument("--workers", type=int, action="append", help="1 and 2 by default")
    parser.add_argument("--kept", action="store_true", help="print what has been found, run nothing")
    options = parser.parse_args()
    if options.kept:
        print(table(list(known_series(options.folder / RESULTS.format(seed=options.seed)).values())))
        return
    preload()
    # Scenes this small would all be planned in one process, and none could be killed.
    benchmark.evaluation.PROCESSES_PAY_AFTER_S = 0.0
    # Its command has no option of how long it trains, which is minutes.
    short = partial(TrainingSettings, steps=60, batch=64)
    adapters.extensions.training.ego_status.TrainingSettings = short  # type: ignore[assignment, misc]
    bench = KillBench(options.folder, options.seed)
    try:
        results = list(_series(bench, options))
    finally:
        bench.end()
    print(table(results))
    for series in results:
        if not series.same:
            print(
                f"\n{series.command}, {series.how}, case {series.number}: {series.said}",
                *series.differences,
                sep="\n  ",
            )
    sys.exit(not all(series.same for series in results))


def cases(options: argparse.Namespace) -> Iterator[tuple[KilledCommand, str, int, int]]:
    """Command, way, workers and number of each case."""
    for number in range(options.moments):
        for command in COMMANDS.values():
            if options.command and command.name not in options.command:
                continue
            for how in options.how or WAYS:
                if (how.startswith("ray") and not command.on_ray) or (how == "server") != command.served:
                    continue
                counts = options.workers or [1, 2] if how == "kill" and command.parallel else [1]
                yield from ((command, how, workers, number) for workers in counts)


def _series(bench: KillBench, options: argparse.Namespace) -> Iterator[Series]:
    path = bench.folder / RESULTS.format(seed=options.seed)
    known = known_series(path)
    for command, how, workers, number in cases(options):
        key = f"{command.name}/{how}/{workers}/{number}"
        if key not in known:
            known[key] = bench.disturbed(command, how, workers, number)
            _require_commit(bench.folder)
            with path.open("a") as stream:
                stream.write(json.dumps({"key": key, "series": asdict(known[key])}) + "\n")
            print(f"{key}: {'same' if known[key].same else 'DIFFERS'}", file=sys.stderr, flush=True)
        yield known[key]


def known_series(path: Path) -> dict[str, Series]:
    """Cases that earlier commands have run, by key."""
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    return {row["key"]: Series(**row["series"]) for row in rows}


def _require_commit(folder: Path) -> None:
    """Refuse to go on where the checkout is no longer that of the series."""
    read_source_state.cache_clear()
    path, now = folder / "source.json", json.dumps(read_source_state(), sort_keys=True)
    if path.is_file() and path.read_text() != now:
        raise InputError(f"{path} says that this series is of another commit; begin another in another --folder")
    path.write_text(now)


def table(found: list[Series]) -> str:
    """A row for each command and way: how often it was disturbed, and how often nothing shows it."""
    rows = sorted({(series.command, series.how) for series in found})
    head = "| command | disturbed by | cases | of them hit | files compared | same bytes |"
    lines = [head, "|---|---|--:|--:|--:|--:|"]
    for row in rows:
        own = [series for series in found if (series.command, series.how) == row]
        hit, same = sum(series.killed > 0 for series in own), sum(series.same for series in own)
        lines.append(f"| {row[0]} | {row[1]} | {len(own)} | {hit} | {own[0].files} | {same} |")
    exempt = "; ".join(f"`{name}/`: {why}" for name, why in EXEMPT.items())
    return "\n".join([*lines, "", f"Not compared: {exempt}."])


if __name__ == "__main__":
    main()
