"""How far wrong set-ups move each number of ``challenger-bench reproduce``, and whether its verdict catches them.

Run as ``python bench/reproduce.py --model vad-mini``: a miniature on scenes of the embedded data set is right by
definition; then each wrong set-up of `bench.wrong_set_ups` is compared with its numbers, with the differences that are
allowed to official weights. Prints a table in Markdown (docs/reproduce.md).
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any, cast

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from adapters.as_published import ALL
from adapters.models import MODELS
from adapters.registry import planner_factory
from bench.wrong_set_ups import PLAIN, RIGHT, WRONG, DataSetUp, SetUp, changed_planner
from benchmark import api
from benchmark.datasets.roots import DataSet
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.extensions.reproduce.reproducing import Expected, compared, expected_file, store_expected
from benchmark.records.reproduction import ComparedNumber, Reproduction
from benchmark.records.run import RunRecord


def run_of(model: str, data: DataSet, scenes: tuple[str, ...], set_up: SetUp, out: Path) -> RunRecord:
    """Evaluate a model in a set-up.

    Args:
        model: Its name.
        data: The data set.
        scenes: Scenes that count as the split.
        set_up: The set-up.
        out: Folder of the run.

    Returns:
        The record.
    """
    options = () if set_up.plain else (ALL,)
    planner = changed_planner(planner_factory(model, as_published=options)(), set_up)
    shown = cast("DataSet", cast("Any", DataSetUp(data, scenes, set_up)))
    judge = MODELS[model].native_protocol
    assert judge is not None, f"{model} has no protocol of its own"
    return evaluate(shown, "val", planner, out / set_up.name, EvalSettings(("exact", judge)))


def rows(right: Reproduction, found: list[tuple[SetUp, Reproduction]]) -> list[str]:
    """The table: a row for each set-up, a column for each number, differences from the right one."""
    names = [f"{number.column} {number.horizon}".strip() for number in right.numbers]
    lines = [f"| set-up | {' | '.join(names)} | verdict |", f"|---|{'--:|' * len(names)}---|"]
    lines.append(f"| right | {' | '.join(_value(number) for number in right.numbers)} | reproduced |")
    for set_up, each in found:
        wrong = sum(not number.ok for number in each.numbers)
        verdict = "reproduced" if each.reproduced else f"not reproduced ({wrong} of {len(each.numbers)})"
        lines.append(f"| {set_up.name} | {' | '.join(_difference(number) for number in each.numbers)} | {verdict} |")
    return lines


def _value(number: ComparedNumber) -> str:
    return "–" if number.ours is None else f"{number.ours:.3f}".rstrip("0").rstrip(".")


def _difference(number: ComparedNumber) -> str:
    if number.difference is None:
        return "–"
    text = f"{number.difference:+.3f}" if number.column != "samples" else f"{number.difference:+.0f}"
    return text if number.ok else f"**{text}**"


def measured(model: str, data: DataSet, scenes: tuple[str, ...], out: Path) -> tuple[Reproduction, Any]:
    """All set-ups of a model: the right one, and the others compared with it."""
    first = run_of(model, data, scenes, RIGHT, out)
    judge, file = first.native_protocol, out / "values.json"
    store_expected(file, first, judge)
    expected: Expected = expected_file(file, model, "val")
    others = (*WRONG, *((PLAIN,) if MODELS[model].net.as_published else ()))
    found = []
    for set_up in others:
        found.append((set_up, compared(run_of(model, data, scenes, set_up, out), expected)))
        print(f"{set_up.name}: done", file=sys.stderr, flush=True)
    return compared(first, expected), found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="vad-mini")
    parser.add_argument("--split", default="val", help="of the embedded data: val, or adv, where planners collide")
    parser.add_argument("--scenes", type=int, default=2, help="of the split, how many")
    parser.add_argument("--out", type=Path, help="folder of the runs; a temporary one by default")
    given = parser.parse_args()
    data = api.open_split(api.open_data("mini"), given.split)
    scenes = data.scene_names(given.split)[: given.scenes]
    with tempfile.TemporaryDirectory() as temporary:
        right, found = measured(given.model, data, scenes, given.out or Path(temporary))
    print("\n".join(rows(right, found)))


if __name__ == "__main__":
    main()
