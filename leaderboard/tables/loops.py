"""Open loop beside closed loop: rates of both on the same scenes, how alike they rank, and where they disagree."""

from collections.abc import Sequence

from benchmark.metrics.loops import OPEN_LOOP, PlannerLoops, RankCorrelation, planner_loops, rank_correlation, run_of
from benchmark.metrics.scores import source_of_scenes
from benchmark.records.drives import DriveRecord
from benchmark.records.run import RunRecord
from benchmark.report.cells import Cell, Origin, Shown, record_name
from benchmark.report.table import Brief, Table, table_of
from benchmark.report.words import counted
from leaderboard.tables.drives import notes_of, origin_of_drives, planner_cell
from leaderboard.tables.worlds import World, worlds

DISAGREEMENTS = "loops-scenes"
"""How names of tables of single scenes begin."""
_RATES_NOTE = (
    f"Open loop: scenes with any sample whose plan collides under {OPEN_LOOP}. Contact, at fault: drives of the same "
    "scenes that end in a contact, and in one that the ego is at fault for. Only open, only closed: scenes that are "
    "failed in that loop alone; agree: share of the others. Only scenes count of which both loops can say."
)
_SCENES_NOTE = (
    "Scenes that a planner fails in one loop and not in the other; only closed: a drive ends in a contact and no plan "
    f"of the recording collides under {OPEN_LOOP}. Contact: of the first run that has one, seconds after the drive "
    "began."
)


def loop_tables(drives: Sequence[DriveRecord], runs: Sequence[RunRecord]) -> list[Table]:
    """Two tables for each thing that was measured: rates, and single scenes.

    Args:
        drives: Records of drives.
        runs: Run records.

    Returns:
        Rates of every world in which a planner drove that ran in open loop, then scenes of those with disagreements.

    Raises:
        InputError: If two records of drives would share a row.
    """
    rates, scenes = [], []
    # Scenarios put actors into scenes that the recording, and so open loop, does not have.
    for one in worlds([each for each in drives if each.facts.measured.scenarios == "recorded"]):
        found, missing = _loops_of(one, runs)
        if found:
            rates.append(_rates_table(one, found, missing))
        if any(scene.disagrees for _, loops in found for scene in loops.scenes):
            scenes.append(_scenes_table(one, found))
    return [*rates, *scenes]


def _loops_of(one: World, runs: Sequence[RunRecord]) -> tuple[list[tuple[str, PlannerLoops]], list[str]]:
    """Planners of a world in both loops, by name, and those without an open loop."""
    found, missing = [], []
    for record, name in zip(one.records, one.planners, strict=True):
        run = run_of(record, runs)
        if run is None:
            missing.append(name)
        else:
            found.append((name, planner_loops(record, run)))
    return found, missing


def _rates_table(one: World, found: Sequence[tuple[str, PlannerLoops]], missing: Sequence[str]) -> Table:
    columns = ["planner", "sensor", "open loop %", "95 %", "contact %", "95 %", "at fault %", "95 %"]
    columns += ["only open", "only closed", "agree %", "scenes"]
    loops = [each for _, each in found]
    ranks = rank_correlation(loops), rank_correlation(loops, at_fault=True)
    left_out = [
        f"{name}: {counted(len(each.without), 'scene')} left out because a drive or a sample failed."
        for name, each in found
        if each.without
    ]
    absent = [f"Without a run record of the same planner and scenes: {', '.join(missing)}."] if missing else []
    notes = (_RATES_NOTE, *_ranked(*ranks), *left_out, *absent, *notes_of(one))
    title = f"{one.title}: beside open loop"
    return table_of(
        f"loops-{one.name}",
        title,
        columns,
        [_rates_row(name, each) for name, each in found],
        notes=notes,
        text_columns=2,
        groups=(("", 2), ("open", 2), ("closed", 4), ("both", 4)),
        brief=Brief(title, (0, 2, 4, 6, 8, 9, 10, 11), notes, text_columns=1),
    )


def _ranked(contact: RankCorrelation, at_fault: RankCorrelation) -> list[str]:
    """Whether closed loop ranks planners as open loop does, in words."""
    where = f"{contact.planners} planners on the {counted(contact.scenes, 'scene')} that all of them have"
    if contact.planners and not contact.scenes:
        where = f"{contact.planners} planners, which have no scene in common"
    said = ", ".join(
        f"{words} {'–' if found.tau is None else f'{found.tau:.2f}'}"
        for words, found in (("contact", contact), ("at fault", at_fault))
    )
    miniatures = "; miniatures are not ranked"
    return [f"Kendall's tau-b between open loop and closed loop: {said} (over {where}{miniatures})."]


def _rates_row(name: str, each: PlannerLoops) -> list[str | Shown]:
    here = origin_of_drives(each.drives, name)
    both = f"{record_name(each.run)}; {here.record}"
    opened, closed = Origin(OPEN_LOOP, record_name(each.run)), Origin(here.protocol, both)
    cells: list[str | Shown] = [planner_cell(each.drives, name), each.drives.facts.measured.sensor]
    for origin, rate in ((opened, each.open_rate), (closed, each.contact), (closed, each.at_fault)):
        cell = origin.percent(rate, "scenes")
        cells += [cell.shown(1), cell.interval()]
    only_open = sum(scene.open_fails and not scene.closed_fails for scene in each.scenes)
    only_closed = sum(scene.closed_fails and not scene.open_fails for scene in each.scenes)
    count = len(each.scenes)
    agree = Cell(None if not count else 100.0 * (count - only_open - only_closed) / count, "%", count, "scenes")
    return [
        *cells,
        closed.count(only_open, "scenes", count).shown(),
        closed.count(only_closed, "scenes", count).shown(),
        agree.shown(1),
        closed.count(count, "scenes", count + len(each.without)).shown(),
    ]


def _scenes_table(one: World, found: Sequence[tuple[str, PlannerLoops]]) -> Table:
    rows: list[list[str | Shown]] = []
    for name, each in found:
        sources = source_of_scenes(each.run)
        for scene in each.scenes:
            if not scene.disagrees:
                continue
            touched = scene.first.first_contact if scene.first is not None else None
            whom = "–" if touched is None else f"{touched.category}{', the adversary' if touched.adversary else ''}"
            blame = "–" if touched is None else ("yes" if touched.at_fault else "no")
            seconds = Cell(None if touched is None else touched.seconds, "s", 1, "drives")
            cells: list[str | Shown] = [planner_cell(each.drives, name), scene.scene, sources[scene.scene]]
            failed = "only open" if scene.open_fails else "only closed"
            rows.append([*cells, failed, whom, blame, seconds.shown(1)])
    title = f"{one.title}: scenes on which open loop and closed loop disagree"
    columns = ("planner", "scene", "recording", "fails", "contact with", "at fault", "contact s")
    notes = (_SCENES_NOTE, *notes_of(one))
    brief = Brief(title, (0, 1, 3, 4, 5, 6), notes, text_columns=5)
    return table_of(f"{DISAGREEMENTS}-{one.name}", title, columns, rows, notes=notes, text_columns=6, brief=brief)
