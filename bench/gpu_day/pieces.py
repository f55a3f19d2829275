"""One piece of a day with a GPU: what it measures, how it is run in a process of its own, and what it leaves."""

import contextlib
import json
import multiprocessing
import os
import resource
import shutil
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from benchmark.errors import InputError
from benchmark.machine.environment import read_machine_metadata as environment_facts
from benchmark.machine.storage import read_cached_json, write_json
from benchmark.machine.workers import end_with_parent

PIECE_LIMIT_S: Final = 540.0
"""A piece is ended after this: whoever lends a GPU for ten minutes at a time gets whole pieces."""
SCHEMA: Final = 1


@dataclass(frozen=True, slots=True)
class Setting:
    """Where and how large everything is.

    Attributes:
        folder: What pieces leave lies below it.
        device: Where networks run.
        tiny: Whether networks have the sizes of the miniatures: the same classes, for a trial without a GPU.
        golden: Folder of golden numbers of official code, a folder for each model, if they are given
            (docs/extensions/golden_sets.md).
        tracks: Recordings that the trajectory prior learns from; the embedded town if none.
    """

    folder: Path
    device: str
    tiny: bool = False
    golden: Path | None = None
    tracks: Path | None = None

    @property
    def on_gpu(self) -> bool:
        """Whether networks run on a GPU."""
        return self.device.startswith("cuda")

    @property
    def kept(self) -> Path:
        """Folder of the figures: those of a trial are never taken for those of a GPU."""
        return self.folder / f"{'cuda' if self.on_gpu else self.device}{'-tiny' if self.tiny else ''}"

    def now(self) -> float:
        """Seconds: on the wall, once a GPU is done with everything; of the processor, where networks run on that."""
        if not self.on_gpu:
            return time.process_time()
        import torch

        torch.cuda.synchronize()
        return time.perf_counter()


@dataclass(frozen=True, slots=True)
class Piece:
    """One piece.

    Attributes:
        name: Its name.
        what: What it measures, for people.
        work: Measures, in a process of its own; figures as JSON values.
        said: Puts the figures into a few words.
        so_far: Of a piece that goes on where it was ended: how far it is.
    """

    name: str
    what: str
    work: Callable[[Setting], dict[str, Any]]
    said: Callable[[dict[str, Any]], str]
    tally_until: Callable[[Setting], dict[str, Any]] | None = None


def mean_seconds(
    setting: Setting, work: Callable[[], object], count: int, before: Callable[[int], object] = int
) -> tuple[float, dict[str, Any]]:
    """Mean time of what a network with random weights does, and that with the most memory meanwhile, GiB, as figures.

    What is done before each, given its number, does not count.
    """
    import torch

    if setting.on_gpu:
        torch.cuda.reset_peak_memory_stats()
    spent = 0.0
    for number in range(count):
        before(number)
        began = setting.now()
        work()
        spent += setting.now() - began
    resident = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak = torch.cuda.max_memory_allocated() if setting.on_gpu else resident
    return spent / count, {"peak_gib": peak / 2**30, "weights": "random"}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a piece.

    Attributes:
        figures: What it measured; of an unfinished one, how far it is.
        failure: Why there is nothing, if there is nothing.
        unfinished: Whether the next call goes on with it.
        seconds: How long this call took for it.
    """

    figures: dict[str, Any] | None = None
    failure: str | None = None
    unfinished: bool = False
    seconds: float = 0.0

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.figures is not None and not self.unfinished


def machine_facts(setting: Setting) -> dict[str, Any]:
    """What figures depend on beside the code: processor, card, driver, torch, commit."""
    # Light until here: a piece's process imports this module first.
    import torch

    known = environment_facts()
    card = torch.cuda.get_device_name(setting.device) if setting.on_gpu else None
    return {
        "processor": known["hardware"]["cpu"],
        "processors": os.cpu_count(),
        "card": card,
        "driver": _driver() if setting.on_gpu else None,
        "torch": torch.__version__,
        "cuda": torch.version.cuda,
        **known["source"],
        "device": setting.device,
        "tiny": setting.tiny,
    }


def _driver() -> str | None:
    if shutil.which("nvidia-smi") is None:
        return None
    query = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    words = subprocess.run(query, capture_output=True, text=True, check=False).stdout.split()
    return words[0] if words else None


def cached_path(setting: Setting, piece: Piece) -> Path:
    """File of what came of a piece."""
    return setting.kept / f"{piece.name}.json"


def cached_outcome(setting: Setting, piece: Piece) -> tuple[Outcome, dict[str, Any]] | None:
    """What came of a piece and on which machine; ``None`` where nothing is kept, or it is damaged."""
    value = read_cached_json(cached_path(setting, piece))
    if not isinstance(value, dict) or value.get("schema") != SCHEMA or value.get("piece") != piece.name:
        return None
    try:
        return Outcome(**value["outcome"]), dict(value["machine"])
    except (KeyError, TypeError, ValueError):
        return None


def run_piece(setting: Setting, piece: Piece, limit_s: float = PIECE_LIMIT_S) -> Outcome:
    """Run a piece in a process of its own, and keep what came of it; not that it had less time than pieces have.

    Args:
        setting: Where and how large.
        piece: The piece.
        limit_s: After this it is ended.

    Returns:
        What came of it.
    """
    begun = time.monotonic()
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(piece.work, setting, sending))
    process.start()
    sending.close()
    answered, unfinished = receiving.poll(limit_s), False
    figures: dict[str, Any] | None = None
    failure: str | None = f"ended after {limit_s:.0f} s"
    if answered:
        failure = "its process ended abruptly, as happens where memory runs out"
        with contextlib.suppress(EOFError):
            figures, failure = receiving.recv()
    else:
        process.terminate()
    process.join()
    if not answered and piece.tally_until is not None:
        figures, failure, unfinished = piece.tally_until(setting), None, True
    outcome = Outcome(figures, failure, unfinished, round(time.monotonic() - begun, 1))
    if answered or unfinished or limit_s >= PIECE_LIMIT_S:
        value = {"schema": SCHEMA, "piece": piece.name, "outcome": asdict(outcome), "machine": machine_facts(setting)}
        write_json(cached_path(setting, piece), value)
    return outcome


def _work(work: Callable[[Setting], dict[str, Any]], setting: Setting, sending: Connection) -> None:
    # Nobody would take its figures, and it would keep the GPU.
    threading.Thread(target=end_with_parent, daemon=True).start()
    try:
        # Figures that are no JSON are a fault of the piece, and shall not end the day.
        sending.send((json.loads(json.dumps(work(setting), allow_nan=False)), None))
    except Exception as error:
        first = (str(error).splitlines() or [""])[0][:200]
        sending.send((None, f"{type(error).__name__}: {first}"))


def find_piece(pieces: tuple[Piece, ...], name: str) -> Piece:
    """A piece by name; raises `InputError` if there is none."""
    match = next((piece for piece in pieces if piece.name == name), None)
    if match is None:
        raise InputError(f"there is no piece {name!r}; they are {', '.join(piece.name for piece in pieces)}")
    return match


def markdown(setting: Setting, pieces: tuple[Piece, ...]) -> str:
    """The figures as a Markdown table for ``docs/studies/speed.md``; what was not run is there too."""
    lines = ["| piece | figures | card | torch | commit |", "|---|---|---|---|---|"]
    for piece in pieces:
        kept = cached_outcome(setting, piece)
        if kept is None:
            lines.append(f"| {piece.name} | not run | | | |")
            continue
        outcome, machine = kept
        card = machine.get("card") or f"none ({machine.get('processor')})"
        commit = str(machine.get("commit") or "")[:7]
        lines.append(
            f"| {piece.name} | {describe_outcome(piece, outcome)} | {card} | {machine.get('torch')} | {commit} |"
        )
    return "\n".join(lines)


def describe_outcome(piece: Piece, outcome: Outcome) -> str:
    """What came of a piece, in a few words."""
    if outcome.figures is None:
        return f"failed: {outcome.failure}"
    if outcome.unfinished:
        return "unfinished: " + ", ".join(f"{name} {value}" for name, value in outcome.figures.items())
    return piece.said(outcome.figures)
