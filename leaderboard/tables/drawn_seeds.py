"""How far collision rates on adversarial scenes move with the seed of their search, beside the interval over scenes."""

from collections.abc import Sequence

from benchmark.errors import InputError
from benchmark.metrics.drawn_seeds import over_seeds, seeds_in_words
from benchmark.metrics.rates import HORIZONS, SceneSums
from benchmark.metrics.scores import scored, source_of_scenes
from benchmark.records.run import RunRecord, protocol_of
from benchmark.records.seed_splits import seed_of
from benchmark.report.cells import PERCENT, AnyRate, Origin, record_name
from benchmark.report.table import Table
from leaderboard.frame.rows import judges, name_cell, run_notes
from leaderboard.frame.runs import Frame, whose
from leaderboard.frame.specification import Values, estimates, intervals, numbers, tabulate, texts, under

_AVERAGE = HORIZONS.index("avg")
_RULE = (
    "Splits adv-seed-N: the same recordings, searched with seed N (generate --seeds). The row of all: the mean "
    "of the rates. Over scenes: 95 % bootstrap interval over recorded scenes, of all seeds with everything that they "
    "made of a recording; it holds the chance of the search, which comes in once for each recording and seed. "
    "Deviation: of the rates of the seeds around their mean (n − 1); over seeds: 95 % interval of that mean (Student) "
    "on these very recordings, as wide as drawing the search again makes it (docs/metrics.md)."
)


def drawn_seeds_table(frame: Frame, protocol: str) -> Table | None:
    """Average collision rate of each planner on the splits ``adv-seed-N`` of several seeds.

    A row a seed, and one for all, for each planner that ran on at least two; ``None`` where there is none. ``native``
    is the protocol of the planner's own repository; what does not belong to the others is named below.
    """
    rows: list[Values] = []
    notes, shown = [_RULE], []
    for runs in _by_planner(frame.runs):
        kept, refused = _comparable(runs, protocol)
        if len(kept) < 2:
            continue
        notes += refused
        rows += _rows(kept, protocol)
        shown += list(kept.values())
    if not rows:
        return None
    columns = [
        *texts("planner", "protocol", "seed"),
        *under("counted", numbers("scenes", "recordings")),
        *under(
            f"average collision rate in %, {whose(protocol)}",
            estimates("avg", digits=2, beside="over scenes"),
            numbers("deviation", digits=2),
            intervals({"over seeds": "over seeds"}),
        ),
    ]
    return tabulate(
        f"drawn-seeds-{protocol}",
        f"{frame.data_name}: average collision rate (%) over seeds of the search, {judges(protocol)}",
        columns,
        rows,
        (*notes, *run_notes(shown, ())),
    )


def _by_planner(records: Sequence[RunRecord]) -> list[dict[int, RunRecord]]:
    """Runs on splits of seeds, by planner and then by seed."""
    found: dict[str, dict[int, RunRecord]] = {}
    for record in records:
        seed = seed_of(record.run.split)
        if seed is not None:
            found.setdefault(record.planner, {})[seed] = record
    return [dict(sorted(runs.items())) for runs in found.values()]


def _comparable(runs: dict[int, RunRecord], protocol: str) -> tuple[dict[int, RunRecord], list[str]]:
    """Runs that differ in the seed of the search alone, and why the others do not count."""
    kept: dict[int, RunRecord] = {}
    refused = []
    for seed, run in runs.items():
        reason = _refusal(seed, run, next(iter(kept.values()), None), protocol)
        if reason is None:
            kept[seed] = run
        else:
            refused.append(f"Left out: {run.planner} on {run.run.split}: {reason}.")
    return kept, refused


def _refusal(seed: int, run: RunRecord, first: RunRecord | None, protocol: str) -> str | None:
    made = run.run.generated
    if made is None or made.seed != seed:
        return "its data set does not say that it was searched with this seed"
    if not (run.covers_split and run.complete):
        return "it has no plan for some samples of the split"
    if first is not None and first.run.generated is not None and first.run.generated.search != made.search:
        return f"it comes from another search than {first.run.split}, not from another seed alone"
    weights = None if first is None else first.run.planner
    if weights is not None and weights != run.run.planner:
        return f"the planner has other weights, settings, code or seed than on {first.run.split if first else ''}"
    try:
        scored(run, protocol=protocol)
    except InputError as refusal:
        return str(refusal)
    return None


def _rows(runs: dict[int, RunRecord], protocol: str) -> list[Values]:
    """A row a seed, and one of all, which alone has a deviation and an interval over seeds."""
    found = over_seeds({seed: _sums(run, protocol) for seed, run in runs.items()})
    first = next(iter(runs.values()))
    judge = protocol_of(first, protocol)
    who: Values = {"planner": name_cell(first.planner, first.run.planner), "protocol": judge}

    def row(seed: str, of: Sequence[RunRecord], recordings: int, rate: AnyRate) -> Values:
        origin = Origin(judge, record_name(*of))
        scenes = origin.count(sum(len(run.run.scenes) for run in of), "scenes")
        counted = {"scenes": scenes, "recordings": origin.count(recordings, "recorded scenes")}
        return {**who, "seed": seed, **counted, "avg": origin.percent(rate)}

    of_each = [(one, run, len(set(source_of_scenes(run).values()))) for one, run in zip(found.seeds, runs.values())]
    rows = [row(str(one.seed), [run], recordings, one.rate) for one, run, recordings in of_each]
    origin, count = Origin(judge, record_name(*runs.values())), len(found.seeds)
    of_seeds = f"seeds {seeds_in_words(list(runs))}"
    every = {
        **row("all", list(runs.values()), found.recordings, found.mean),
        "deviation": origin.cell(found.deviation, PERCENT, count, of_seeds, scale=100.0),
        "over seeds": origin.cell(
            found.mean.value, PERCENT, count, "seeds", low=found.low, high=found.high, scale=100.0
        ),
    }
    return [*rows, every]


def _sums(run: RunRecord, protocol: str) -> SceneSums:
    """Sums that each recording adds to the average rate."""
    whole = scored(run, protocol=protocol).sums(source_of_scenes(run))
    column = slice(_AVERAGE, _AVERAGE + 1)
    return SceneSums(whole.names, whole.numerators[:, column], whole.denominators[:, column])
