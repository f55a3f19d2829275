"""What planners, engines and driving scores want of a data set and do not get, and what of it cannot be, as caveats."""

from collections.abc import Iterator, Mapping, Sequence

from benchmark.datasets.implausible import MISFIT_SHARE, lie_across
from benchmark.records.caveats import Caveat
from benchmark.records.drive_schema import Measured
from benchmark.records.rows import Rows
from benchmark.records.run_schema import InputFacts, PlannerFacts, SceneFacts
from benchmark.report.words import counted

_DERIVED, _OFFERED, _WITHOUT = '"ego_motion":"derived"', '"forecasts":{', '"forecasts":null'
"""In the JSON of a row, where text that a planner wrote cannot have them: its quotation marks are escaped."""


def data_caveats(scenes: Mapping[str, SceneFacts]) -> Iterator[Caveat]:
    """Caveats about impossible values of a data set; of older records they are not known."""
    facts = inputs_of(scenes)
    on_maps = [each for each in facts.values() if each.off_road is not None]
    share = sum(each.off_road or 0 for each in on_maps) / max(sum(each.samples for each in on_maps), 1)
    if share > MISFIT_SHARE:
        yield Caveat(
            kind="map",
            sentence=f"the recorded ego is off the drivable area of the map in {100 * share:.0f} % of the samples: the "
            "map does not fit, and neither do lanes and driving scores",
        )
    if jumps := sum(each.jumps for each in facts.values()):
        yield Caveat(
            kind="boxes",
            sentence=f"{counted(jumps, 'annotation')} of objects that jump (over 60 m/s since the one before): "
            "contacts with them are of no real motion",
        )
    moving, across = (sum(getattr(each, name) for each in facts.values()) for name in ("moving", "across"))
    if lie_across(moving, across):
        yield Caveat(
            kind="boxes",
            sentence=f"the boxes of {across} of {counted(moving, 'moving object')} lie across their motion (width and "
            "length exchanged, or headings turned by 90 degrees): contacts are not where they would be",
        )
    if turned := [name for name, each in facts.items() if each.turned_quaternions]:
        yield Caveat(
            kind="pose",
            sentence=f"rotations in {_of(turned, facts)} make sense only if read as x, y, z, w, and nuScenes has w "
            "first: headings and all that follows from them are wrong",
        )
    if without := [name for name, each in facts.items() if not each.lidar]:
        yield Caveat(
            kind="lidar",
            sentence=f"{_of(without, facts)} {_have(without)} no LIDAR_TOP: the lidar, whose place plans and protocols "
            "count from, is taken to sit as on nuScenes' cars",
        )


def map_caveats(scenes: Mapping[str, SceneFacts], goes_without: Sequence[str]) -> Iterator[Caveat]:
    """Caveat about scenes that have no map with lanes, one at most.

    Args:
        goes_without: What happens without lanes, in words; nothing is said if nothing does.
    """
    facts = inputs_of(scenes)
    without = [name for name, each in facts.items() if not each.lanes]
    if without and goes_without:
        yield Caveat(
            kind="map",
            sentence=f"{_of(without, facts)} {_have(without)} no map with lanes: {', and '.join(goes_without)}",
        )


def planner_caveats(planner: PlannerFacts, scenes: Mapping[str, SceneFacts], rows: Rows) -> Iterator[Caveat]:
    """Caveats about inputs that a planner wanted and did not get, and about plans that lack what the others have."""
    lanes = ["it drives straight on where it would follow a lane"] if "map" in planner.wants else []
    yield from map_caveats(scenes, [*lanes, "there are no driving scores (pdm)"])
    facts = inputs_of(scenes)
    blind = [name for name, each in facts.items() if not each.cameras]
    if blind and "images" in planner.wants:
        yield Caveat(kind="images", sentence=f"{_of(blind, facts)} {_have(blind)} no camera, and it plans from images")
    derived: list[str] = []
    offered, without = 0, 0
    for scene, lines in rows.texts():
        if all(_DERIVED in line for line in lines):
            derived.append(scene)
        offered += sum(_OFFERED in line for line in lines)
        without += sum(_WITHOUT in line for line in lines)
    if derived and "motion" in planner.wants:
        yield Caveat(
            kind="motion",
            sentence=f"{_of(derived, scenes)} {_have(derived)} no CAN bus: the ego motion that it plans from "
            "is derived from poses",
        )
    if offered and without:
        yield Caveat(
            kind="forecasts",
            sentence=f"{without} of {counted(offered + without, 'plan')} have no forecasts, and the others do: no "
            "cause is said of their collisions",
        )


def drive_input_caveats(
    planner: PlannerFacts, scenes: Mapping[str, SceneFacts], measured: Measured
) -> Iterator[Caveat]:
    """Caveats about map inputs that a planner, the engine, its agents and the sensor wanted and did not get."""
    goes_without = ["it drives straight on where it would follow a lane"] if "map" in planner.wants else []
    if measured.agents == "idm":
        goes_without.append("agents drive straight on where their recorded way ends")
    if measured.sensor == "schematic":
        goes_without.append("pictures have no road")
    if measured.engine == "default":
        goes_without.append("there are no terms of nuPlan and no HD-Score")
    yield from map_caveats(scenes, goes_without)


def inputs_of(scenes: Mapping[str, SceneFacts]) -> dict[str, InputFacts]:
    """Inputs that the data set holds of scenes, of those for which it is known."""
    return {name: each.truth.inputs for name, each in scenes.items() if each.truth is not None and each.truth.inputs}


def _of(some: Sequence[str], scenes: Mapping[str, object]) -> str:
    """Scenes in words; one is named, several are counted."""
    return some[0] if len(some) == 1 else f"{len(some)} of {counted(len(scenes), 'scene')}"


def _have(some: Sequence[str]) -> str:
    return "has" if len(some) == 1 else "have"
