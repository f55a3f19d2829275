"""One case of the table, and how its two sides are measured in turns."""

import importlib.util
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.machine import workers

Side = Callable[[Any], tuple[float, Any]]
"""Works on a state; how many units that were, and what came of it."""


@dataclass(frozen=True, slots=True)
class Case:
    """One line of the table.

    Attributes:
        name: Its name, `SUBJECT` or `SUBJECT/PART`.
        measures: What it measures, in a sentence.
        setup: Makes the state; whether a small size is wanted, and an empty folder.
        ours: The side that is measured.
        unit: What its units are.
        other: What stands beside it, a slow reference or another way, in a few words; and its side.
        same: Whether both came to the same, of the state and both results.
        more: Further figures, of the state and our result.
        digest: A word for our result that has to be the same in another commit.
        fresh: Whether each turn needs a new state, because the first one leaves things in it.
        wall: Whether time on the clock counts, not of processors: GPUs, several processes side by side.
        needs: Packages, or `gpu`.
        on_request: Whether it is run only by name.
        most_s, least_ratio, most_mb: What a unit, the ratio, and the process must keep to at full size.
    """

    name: str
    measures: str
    setup: Callable[[bool, Path], Any]
    ours: Side
    unit: str
    other: tuple[str, Side] | None = None
    same: Callable[[Any, Any, Any], bool] | None = None
    more: Callable[[Any, Any], str] | None = None
    digest: Callable[[Any], str] | None = None
    fresh: bool = False
    wall: bool = False
    needs: tuple[str, ...] = ()
    on_request: bool = False
    most_s: float | None = None
    least_ratio: float | None = None
    most_mb: float | None = None

    def missing(self) -> str | None:
        """Why it cannot run here, if it cannot."""
        for need in self.needs:
            if need == "gpu":
                import torch

                if not torch.cuda.is_available():
                    return "it needs a GPU"
            elif importlib.util.find_spec(need) is None:
                return f"it needs the package {need}"
        return None


def processor_seconds() -> float:
    """Of this process, its workers and those that it waited for; other work on the machine disturbs it least."""
    return sum(workers.processor_seconds())


def peak_mb() -> float:
    """Most memory that this process or one that it waited for held."""
    return max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)) / 1024


def measure(
    case: Case, folder: Path, *, quick: bool = False, repeat: int = 3, clock: Callable[[], float] | None = None
) -> dict[str, Any]:
    """Both sides in turns; the least time of each counts. Figures as JSON values."""
    clock = clock or (time.perf_counter if case.wall else processor_seconds)
    beside, sides = "", [case.ours]
    if case.other is not None:
        beside, sides = case.other[0], [case.ours, case.other[1]]
    best, results, state, same = [float("inf")] * len(sides), [None] * len(sides), None, True
    for turn in range(repeat):
        if case.fresh or turn == 0:
            (place := folder / str(turn)).mkdir()
            state = case.setup(quick, place)
        for number, side in enumerate(sides):
            started = clock()
            units, results[number] = side(state)
            best[number] = min(best[number], (clock() - started) / units)
        same &= case.same is None or case.same(state, *results)
    figures: dict[str, Any] = {"name": case.name, "unit": case.unit, "ours_s": best[0], "peak_mb": round(peak_mb())}
    if case.other is not None:
        figures |= {"other_s": best[1], "beside": beside, "ratio": best[1] / best[0]}
    if case.more is not None:
        figures["more"] = case.more(state, results[0])
    if case.digest is not None:
        figures["digest"] = case.digest(results[0])
    limits = [] if quick else _find_excesses(case, figures)
    return figures | {"wrong": [*limits, *(() if same else (f"{beside}: comes to something else",))]}


def _find_excesses(case: Case, figures: dict[str, Any]) -> list[str]:
    faults = []
    if case.most_s is not None and figures["ours_s"] > case.most_s:
        faults.append(f"too slow: at most {format_seconds(case.most_s)} per {case.unit} are meant")
    if case.least_ratio is not None and figures["ratio"] < case.least_ratio:
        faults.append(f"too slow: {case.least_ratio:.2f} times as fast is meant")
    if case.most_mb is not None and figures["peak_mb"] > case.most_mb:
        faults.append(f"too large: at most {case.most_mb:.0f} MB are meant")
    return faults


def format_seconds(seconds: float) -> str:
    """With a unit that leaves few zeros."""
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def format_line(figures: dict[str, Any]) -> str:
    """One line for people."""
    text = f"{figures['name']:<32} {format_seconds(figures['ours_s'])} per {figures['unit']}"
    if "ratio" in figures:
        text += f"; {figures['beside']} {format_seconds(figures['other_s'])}: {figures['ratio']:.3g} times"
    if "there_s" in figures:
        times = figures["there_s"] / figures["ours_s"]
        text += f"; in the other tree {format_seconds(figures['there_s'])}: {times:.2f} times"
    return "; ".join([text, *filter(None, [figures.get("more")]), f"{figures['peak_mb']} MB", *figures["wrong"]])
