"""A day with a GPU: everything that waits for one, in pieces of under ten minutes that the next call goes on with.

Run as ``python bench/gpu.py`` (``make gpu``). Each piece runs in a process of its own and leaves its figures, with the
machine, card, driver, torch and commit, in a file of its own; a piece that is done is not run again. ``--list`` says
what is done and what is left, ``--piece NAME`` runs one anew, ``--minutes 9`` ends after so long, and ``--table``
prints the table for ``docs/studies/speed.md``. ``--device cpu --tiny`` runs all of it anywhere, as a trial: the
same classes in the sizes of the miniatures. Weights are random, on which speed does not depend.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import torch

from bench.gpu_day.magicdrive import magicdrive_pieces
from bench.gpu_day.networks import network_pieces
from bench.gpu_day.pieces import (
    PIECE_LIMIT_S,
    Piece,
    Setting,
    cached_outcome,
    describe_outcome,
    find_piece,
    markdown,
    run_piece,
)
from bench.gpu_day.training import training_pieces
from benchmark.errors import InputError
from benchmark.machine.devices import select_device

PIECES = (*network_pieces(), *magicdrive_pieces(), *training_pieces())


def main(arguments: Sequence[str] | None = None, pieces: tuple[Piece, ...] = PIECES) -> int:
    """Run pieces, or say what is kept of them; 1 if one failed or is left, 2 for what cannot be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("challenger-out") / "gpu")
    parser.add_argument("--device", default="cuda", help="cuda, cuda:1, or cpu for a trial")
    parser.add_argument("--tiny", action="store_true", help="sizes of the miniatures")
    parser.add_argument("--golden", type=Path, help="folder of golden numbers, a folder for each model")
    parser.add_argument("--tracks", type=Path, help="recordings for the trajectory prior; the embedded town if none")
    parser.add_argument("--piece", action="append", metavar="NAME", help="only this one, also if it is done")
    parser.add_argument("--minutes", type=float, help="end after so long; the next call goes on")
    parser.add_argument("--list", action="store_true", help="what is done and what is left")
    parser.add_argument("--table", action="store_true", help="the figures as a Markdown table")
    chosen = parser.parse_args(arguments)
    setting = Setting(chosen.folder, chosen.device, chosen.tiny, chosen.golden, chosen.tracks)
    try:
        if chosen.list:
            print("\n".join(f"{piece.name:28s} {_state(setting, piece)}" for piece in pieces))
            return 0
        if chosen.table:
            print(markdown(setting, pieces))
            return 0
        select_device(chosen.device)
        kept = {piece.name: cached_outcome(setting, piece) for piece in pieces}
        left = [name for name, outcome in kept.items() if outcome is None or not outcome[0].finished]
        wanted = [find_piece(pieces, name) for name in chosen.piece or left]
    except InputError as error:
        print(f"{error} (--device cpu --tiny is a trial)" if "GPU" in str(error) else error, file=sys.stderr)
        return 2
    return _run(setting, wanted, chosen.minutes)


def _run(setting: Setting, wanted: Sequence[Piece], minutes: float | None) -> int:
    begun, sound = time.monotonic(), True
    for number, piece in enumerate(wanted):
        left_s = PIECE_LIMIT_S if minutes is None else 60 * minutes - (time.monotonic() - begun)
        if left_s <= 0:
            print(f"{len(wanted) - number} pieces are left; run the same command again")
            return 1
        outcome = run_piece(setting, piece, min(left_s, PIECE_LIMIT_S))
        print(f"{piece.name}: {describe_outcome(piece, outcome)} ({outcome.seconds:.0f} s)", flush=True)
        sound &= outcome.finished
    return 0 if sound else 1


def _state(setting: Setting, piece: Piece) -> str:
    kept = cached_outcome(setting, piece)
    if kept is None:
        return f"left: {piece.what}"
    outcome, machine = kept
    where = machine.get("card") or "no GPU"
    return f"{'done' if outcome.finished else 'left'}: {describe_outcome(piece, outcome)}, {where}"


if __name__ == "__main__":
    torch.set_num_threads(torch.get_num_threads() if "--tiny" not in sys.argv else 1)
    sys.exit(main())
