"""Open loop beside closed loop: rates of both on the same scenes, how alike they rank, and where they disagree."""

from collections.abc import Sequence

from benchmark.metrics.loops import (
    OPEN_LOOP,
    PlannerLoops,
    RankCorrelation,
    SceneLoops,
    planner_loops,
    rank_correlation,
    run_of,
)
from benchmark.metrics.scores import source_of_scenes
from benchmark.records.drives import DriveRecord
from benchmark.records.run import RunRecord
from benchmark.report.cells import Cell, Origin, record_name
from benchmark.report.table import Table
from benchmark.report.words import counted
from leaderboard.frame.drives import Driven, World, worlds
from leaderboard.frame.specification import Value, Values, estimates, numbers, tabulate, texts, under

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
_Both = tuple[Driven, PlannerLoops]
"""A planner in closed loop, and in both."""
_RATES = [
    *texts("planner", "sensor"),
    *under("open", estimates("open loop %", beside="95 %")),
    *under("closed", estimates("contact %", "at fault %", beside="95 %")),
    *under("both", numbers("only open", "only closed"), numbers("agree %", digits=1), numbers("scenes")),
]
_BRIEF_RATES = ("planner", "open loop %", "contact %", "at fault %", "only open", "only closed", "agree %", "scenes")
_SCENES = [
    *texts("planner", "scene", "recording", "fails", "contact with", "at fault"),
    *numbers("contact s", digits=1),
]
_BRIEF_SCENES = ("planner", "scene", "fails", "contact with", "at fault", "contact s")


def loop_tables(drives: Sequence[DriveRecord], runs: Sequence[RunRecord]) -> list[Table]:
    """Rates of every world in which a planner drove that ran in open loop, then scenes of those with disagreements."""
    rates, scenes = [], []
    # Scenarios put actors into scenes that the recording, and so open loop, does not have.
    for one in worlds([each for each in drives if each.facts.measured.scenarios == "recorded"]):
        found, missing = _loops_of(one, runs)
        if found:
            rates.append(_rates_table(one, found, missing))
        if any(scene.disagrees for _, loops in found for scene in loops.scenes):
            scenes.append(_scenes_table(one, found))
    return [*rates, *scenes]


def _loops_of(one: World, runs: Sequence[RunRecord]) -> tuple[list[_Both], list[str]]:
    """Planners of a world in both loops, and names of those without an open loop."""
    found, missing = [], []
    for row in one.rows:
        run = run_of(row.record, runs)
        if run is None:
            missing.append(row.name)
        else:
            found.append((row, planner_loops(row.record, run)))
    return found, missing


def _rates_table(one: World, found: Sequence[_Both], missing: Sequence[str]) -> Table:
    loops = [each for _, each in found]
    ranks = rank_correlation(loops), rank_correlation(loops, at_fault=True)
    left_out = [
        f"{row.name}: {counted(len(each.without), 'scene')} left out because a drive or a sample failed."
        for row, each in found
        if each.without
    ]
    absent = [f"Without a run record of the same planner and scenes: {', '.join(missing)}."] if missing else []
    notes = (_RATES_NOTE, *_ranked(*ranks), *left_out, *absent, *one.notes)
    rows = [_rates_values(row, each) for row, each in found]
    return tabulate(f"loops-{one.name}", f"{one.title}: beside open loop", _RATES, rows, notes, brief=_BRIEF_RATES)


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


def _rates_values(row: Driven, each: PlannerLoops) -> Values:
    here, count = row.origin, len(each.scenes)
    opened = Origin(OPEN_LOOP, record_name(each.run))
    closed = Origin(here.protocol, f"{record_name(each.run)}; {here.record}")
    only_open = sum(scene.open_fails and not scene.closed_fails for scene in each.scenes)
    only_closed = sum(scene.closed_fails and not scene.open_fails for scene in each.scenes)
    agree = None if not count else 100.0 * (count - only_open - only_closed) / count
    return {
        "planner": row.planner,
        "sensor": row.record.facts.measured.sensor,
        "open loop %": opened.percent(each.open_rate, "scenes"),
        "contact %": closed.percent(each.contact, "scenes"),
        "at fault %": closed.percent(each.at_fault, "scenes"),
        "only open": closed.count(only_open, "scenes", count),
        "only closed": closed.count(only_closed, "scenes", count),
        "agree %": Cell(agree, "%", count, "scenes"),
        "scenes": closed.count(count, "scenes", count + len(each.without)),
    }


def _scenes_table(one: World, found: Sequence[_Both]) -> Table:
    rows = [
        {"planner": row.planner, "recording": source_of_scenes(each.run)[scene.scene], **_scene_values(scene)}
        for row, each in found
        for scene in each.scenes
        if scene.disagrees
    ]
    title = f"{one.title}: scenes on which open loop and closed loop disagree"
    notes = (_SCENES_NOTE, *one.notes)
    return tabulate(f"{DISAGREEMENTS}-{one.name}", title, _SCENES, rows, notes, brief=_BRIEF_SCENES)


def _scene_values(scene: SceneLoops) -> dict[str, Value]:
    touched = scene.first.first_contact if scene.first is not None else None
    adversary = ", the adversary" if touched is not None and touched.adversary else ""
    return {
        "scene": scene.scene,
        "fails": "only open" if scene.open_fails else "only closed",
        "contact with": None if touched is None else f"{touched.category}{adversary}",
        "at fault": None if touched is None else ("yes" if touched.at_fault else "no"),
        "contact s": Cell(None if touched is None else touched.seconds, "s", 1, "drives"),
    }
