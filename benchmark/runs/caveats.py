"""The caveats of a record: key frames at other times, missing truth, and missing or impossible input."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Final

from benchmark.datasets.annotated_objects import AnnotationCount
from benchmark.datasets.categories import SENSOR
from benchmark.datasets.truth_facts import MISFIT_SHARE, are_boxes_across
from benchmark.machine.extension import call_extension
from benchmark.records.attempts import EGO, PANEL
from benchmark.records.caveats import OF_THE_DOOR, Caveat, sort_caveats
from benchmark.records.drive_schema import ClosedLoopDefinition, EpisodeRow
from benchmark.records.rows import SampleRows
from benchmark.records.run_schema import InputFacts, PlannerFacts, SceneFacts, TruthFacts
from benchmark.report.words import pluralise
from benchmark.untrusted.plan_plausibility import ComparedPlans
from benchmark.untrusted.plan_verdicts import list_plan_caveats

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_DERIVED, _OFFERED, _WITHOUT = '"ego_motion":"derived"', '"forecasts":{', '"forecasts":null'
"""In the JSON of a row, where text that a planner wrote cannot have them: its quotation marks are escaped."""


def list_data_caveats(scenes: Mapping[str, SceneFacts]) -> Iterator[Caveat]:
    """Caveats about impossible values of a data set; of older records they are not known."""
    facts = collect_inputs(scenes)
    on_maps = [inputs for inputs in facts.values() if inputs.off_road is not None]
    share = sum(inputs.off_road or 0 for inputs in on_maps) / max(sum(inputs.samples for inputs in on_maps), 1)
    if share > MISFIT_SHARE:
        yield Caveat(
            kind="map",
            sentence=f"the recorded ego is off the drivable area of the map in {100 * share:.0f} % of the samples: the "
            "map does not match, so lanes and driving scores are wrong",
        )
    if jumps := sum(inputs.jumps for inputs in facts.values()):
        yield Caveat(
            kind="boxes",
            sentence=f"{pluralise(jumps, 'annotation')} of objects that jump (over 60 m/s since the previous one): "
            "contacts with them are not realistic",
        )
    moving, across = (sum(getattr(inputs, name) for inputs in facts.values()) for name in ("moving", "across"))
    if are_boxes_across(moving, across):
        yield Caveat(
            kind="boxes",
            sentence=f"the boxes of {across} of {pluralise(moving, 'moving object')} lie across their motion "
            "(width and length exchanged, or headings turned by 90 degrees): contacts are misplaced",
        )
    if turned := [name for name, inputs in facts.items() if inputs.turned_quaternions]:
        yield Caveat(
            kind="pose",
            sentence=f"rotations in {_format_scenes(turned, facts)} make sense only if read as x, y, z, w, and "
            "nuScenes has w first: headings and all derived values are wrong",
        )
    if without := [name for name, inputs in facts.items() if not inputs.lidar]:
        yield Caveat(
            kind="lidar",
            sentence=f"{_format_scenes(without, facts)} {_have(without)} no LIDAR_TOP: the lidar, from "
            "whose place plans and protocols count, is assumed to be mounted as on nuScenes' cars",
        )


def list_map_caveats(scenes: Mapping[str, SceneFacts], goes_without: Sequence[str]) -> Iterator[Caveat]:
    """Caveat about scenes that have no map with lanes, one at most; ``goes_without`` words what happens then."""
    facts = collect_inputs(scenes)
    without = [name for name, inputs in facts.items() if not inputs.lanes]
    if without and goes_without:
        yield Caveat(
            kind="map",
            sentence=f"{_format_scenes(without, facts)} {_have(without)} no map with lanes: "
            f"{', and '.join(goes_without)}",
        )


def list_planner_caveats(planner: PlannerFacts, scenes: Mapping[str, SceneFacts], rows: SampleRows) -> Iterator[Caveat]:
    """Caveats about inputs that a planner wanted and did not get, and about plans that lack what the others have."""
    lanes = ["the planner drives straight instead of following a lane"] if "map" in planner.wants else []
    yield from list_map_caveats(scenes, [*lanes, "driving scores (pdm) are not computed"])
    facts = collect_inputs(scenes)
    blind = [name for name, inputs in facts.items() if not inputs.cameras]
    if blind and "images" in planner.wants:
        yield Caveat(
            kind="images", sentence=f"{_format_scenes(blind, facts)} {_have(blind)} no camera, but it needs images"
        )
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
            sentence=f"{_format_scenes(derived, scenes)} {_have(derived)} no CAN bus: the ego motion that it "
            "plans from is derived from poses",
        )
    if offered and without:
        yield Caveat(
            kind="forecasts",
            sentence=f"{without} of {pluralise(offered + without, 'plan')} have no forecasts, unlike the others: no "
            "cause is given for their collisions",
        )


def list_source_caveats(planner: PlannerFacts, data: "DataSet", scenes: Sequence[str]) -> list[Caveat]:
    """Caveats about views that a rig lacks, how far it is from the one that networks know, and who chose scenes."""
    panel = (data.provenance() or {}).get(PANEL)
    chosen = f"scenes were chosen by how hard they are for {panel}, which is not held out"
    caveats = [Caveat(kind="panel", sentence=chosen[:1000])] if isinstance(panel, str) else []
    ego = (data.provenance() or {}).get(EGO)
    if isinstance(ego, str):
        driven = f"the ego is not the recorded one: the reference driver {ego[:20]} drove it and saw what happened"
        caveats.append(Caveat(kind="ego", sentence=f"{driven}; L2 is the distance to where it went"))
    if not any(name.startswith(SENSOR) for name, _ in data.categories):
        return caveats
    sentences = call_extension("names", "caveats", planner, data.categories, data.scene(scenes[0]).cameras)
    return caveats + [Caveat(kind="cameras", sentence=sentence) for sentence in sentences]


def list_drive_input_caveats(
    planner: PlannerFacts, scenes: Mapping[str, SceneFacts], measured: ClosedLoopDefinition
) -> Iterator[Caveat]:
    """Caveats about map inputs that a planner, the engine, its agents and the sensor wanted and did not get."""
    goes_without = ["the planner drives straight instead of following a lane"] if "map" in planner.wants else []
    if measured.agents == "idm":
        goes_without.append("agents continue straight where their recorded path ends")
    if measured.sensor == "schematic":
        goes_without.append("pictures show no road")
    if measured.engine == "default":
        goes_without.append("nuPlan terms and HD-Score are not computed")
    yield from list_map_caveats(scenes, goes_without)


def collect_inputs(scenes: Mapping[str, SceneFacts]) -> dict[str, InputFacts]:
    """Inputs that the data set holds of scenes, of those for which it is known."""
    return {
        name: scene_facts.truth.inputs
        for name, scene_facts in scenes.items()
        if scene_facts.truth is not None and scene_facts.truth.inputs
    }


def _format_scenes(names: Sequence[str], scenes: Mapping[str, object]) -> str:
    """Scenes in words; one is named, several are counted."""
    return names[0] if len(names) == 1 else f"{len(names)} of {pluralise(len(scenes), 'scene')}"


def _have(names: Sequence[str]) -> str:
    return "has" if len(names) == 1 else "have"


_NAMED: Final = 3
_DRIVES: Final = "collision rates and scores that use contacts exclude drives there"


def list_run_truth_caveats(scenes: Mapping[str, SceneFacts], rows: SampleRows) -> Iterator[Caveat]:
    """Caveats of a run record about the truth of its scenes."""
    known = _known(scenes)
    yield from _labels(known, "collision rates and counts of failed scenes exclude them")
    partly = [name for name, truth in known.items() if truth.annotations and truth.unlabelled]
    if partly:
        of = pluralise(sum(len(rows.columns.places_of_scenes[name]) for name in partly), "sample")
        unlabelled = sum(known[name].unlabelled for name in partly)
        yield Caveat(
            kind="truth",
            sentence=f"{_scenes(partly, len(scenes))} incomplete annotations: {unlabelled} of {of} there are excluded "
            "from collision rates",
        )
    complete = rows.columns.flags("complete")
    short = [name for name, places in rows.columns.places_of_scenes.items() if not complete[places].any()]
    if short:
        yield Caveat(
            kind="truth",
            sentence=f"{_scenes(short, len(scenes))} no sample with 3 s of recorded future: only protocols that "
            "count incomplete samples have a rate there",
        )
    yield from _boxes(known)
    yield from _categories(known, "protocols that depend on categories cannot detect contacts")
    yield from _poses(known, len(scenes))


def list_drive_truth_caveats(scenes: Mapping[str, SceneFacts]) -> Iterator[Caveat]:
    """Caveats of a record of drives; arguments as of `list_run_truth_caveats`."""
    known = _known(scenes)
    yield from _labels(known, _DRIVES)
    partly = [name for name, truth in known.items() if truth.annotations and truth.unlabelled]
    if partly:
        yield Caveat(
            kind="truth",
            sentence=f"{_scenes(partly, len(known))} incomplete annotations: {_DRIVES}",
        )
    yield from _boxes(known)
    yield from _categories(known, "fault attribution and scores that depend on the kind of road user may be wrong")
    yield from _poses(known, len(scenes))


def _known(scenes: Mapping[str, SceneFacts]) -> dict[str, TruthFacts]:
    return {name: facts.truth for name, facts in scenes.items() if facts.truth is not None}


def _labels(known: Mapping[str, TruthFacts], consequence: str) -> Iterator[Caveat]:
    none = [name for name, truth in known.items() if not truth.annotations]
    if none:
        yield Caveat(kind="truth", sentence=f"{_scenes(none, len(known))} no annotations: {consequence}")


def _boxes(known: Mapping[str, TruthFacts]) -> Iterator[Caveat]:
    without = {name: truth.without_size for name, truth in known.items() if truth.without_size}
    if without:
        yield Caveat(
            kind="boxes",
            sentence=f"{pluralise(sum(without.values()), 'annotation')} of {_names([*without])} without length, "
            "width or height: they are ignored",
        )


def _categories(known: Mapping[str, TruthFacts], consequence: str) -> Iterator[Caveat]:
    total = AnnotationCount.together([AnnotationCount(truth.annotations, truth.unknown) for truth in known.values()])
    if total.unknown:
        few = "protocols that depend on categories ignore them"
        advice = f"{consequence}; map them with --categories" if total.is_mostly_unknown else few
        yield Caveat(kind="categories", sentence=f"{total.sentence}: {advice}")


def _poses(known: Mapping[str, TruthFacts], scenes: int) -> Iterator[Caveat]:
    still = [name for name, truth in known.items() if truth.motionless]
    if still:
        yield Caveat(
            kind="pose",
            sentence=f"{_scenes(still, scenes)} the same ego pose at every sample, as if it were missing: L2 and "
            "verdicts there are those of a stationary car",
        )


def _scenes(names: Sequence[str], among: int) -> str:
    return f"{len(names)} of {pluralise(among, 'scene')} ({_names(names)}) {'has' if len(names) == 1 else 'have'}"


def _names(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")


def list_time_caveats(scenes: Mapping[str, SceneFacts]) -> list[Caveat]:
    """Caveats about times: of scenes at another rate, and of gaps at 2 Hz; none where key frames are steps."""
    truths = [facts.truth for facts in scenes.values() if facts.truth is not None]
    sentences = []
    rates_s = sorted({truth.interval_s for truth in truths if truth.interval_s is not None})
    if rates_s:
        scene_count = sum(truth.interval_s is not None for truth in truths)
        interval_text = f"{rates_s[0]:.3g} s" if len(rates_s) == 1 else f"{rates_s[0]:.3g} to {rates_s[-1]:.3g} s"
        sentences.append(
            f"the key frames of {pluralise(scene_count, 'scene')} are {interval_text} apart, not 0.5 s: exact "
            "and driving scores "
            "interpolate steps, and official protocols, whose steps are key frames, do not count these samples"
        )
    irregular = [truth for truth in truths if truth.interval_s is None and truth.irregular]
    if irregular:
        samples, cut = (sum(getattr(truth, name) for truth in irregular) for name in ("irregular", "cut_short"))
        sentences.append(
            f"{pluralise(samples, 'sample')} of {pluralise(len(irregular), 'scene')} have key frames ahead that are "
            "not half a second apart: exact and driving scores interpolate steps there"
            + (f" and give no verdict beyond a gap over 0.75 s ({pluralise(cut, 'sample')})" if cut else "")
            + ", and official protocols take the k-th key frame for step k"
        )
    return [Caveat(kind="time", sentence=sentence) for sentence in sentences]


_Scenes = Mapping[str, SceneFacts]
_OF_RUNS: Final[tuple[Callable[[PlannerFacts, _Scenes, SampleRows], Iterable[Caveat]], ...]] = (
    lambda _, scenes, rows: list_run_truth_caveats(scenes, rows),
    lambda _, scenes, __: list_time_caveats(scenes),
    lambda _, scenes, __: list_data_caveats(scenes),
    list_planner_caveats,
)
_OF_DRIVES: Final[tuple[Callable[[PlannerFacts, _Scenes, ClosedLoopDefinition], Iterable[Caveat]], ...]] = (
    lambda _, scenes, __: list_drive_truth_caveats(scenes),
    lambda _, scenes, __: list_time_caveats(scenes),
    lambda _, scenes, __: list_data_caveats(scenes),
    list_drive_input_caveats,
)


def list_run_caveats(
    planner: PlannerFacts, scenes: Mapping[str, SceneFacts], rows: SampleRows, known: Sequence[Caveat] = ()
) -> list[Caveat]:
    """Caveats of a run, in order: inputs that its numbers needed and did not get.

    Of ``known``, from the command that took the plans in or a stored record, only what cannot be found out again is
    taken.
    """
    columns = rows.columns
    compared = ComparedPlans.of(columns.in_lidar, columns.recorded)
    input_caveats = (find(planner, scenes, rows) for find in _OF_RUNS)
    return sort_caveats(chain(_select_file_caveats(known), *input_caveats, _of_plans(compared, known)))


def list_drive_caveats(
    planner: PlannerFacts,
    scenes: Mapping[str, SceneFacts],
    rows: Sequence[EpisodeRow],
    measured: ClosedLoopDefinition,
    compared: ComparedPlans,
    known: Sequence[Caveat] = (),
) -> list[Caveat]:
    """`list_run_caveats` of a record of drives; ``compared`` are plans made where the ego was as recorded."""
    input_caveats = (find(planner, scenes, measured) for find in _OF_DRIVES)
    return sort_caveats(chain(_select_file_caveats(known), *input_caveats, _of_plans(compared, known)))


def _select_file_caveats(known: Sequence[Caveat]) -> list[Caveat]:
    """Known caveats that are kept, since they cannot be found out again."""
    return [caveat for caveat in known if caveat.kind in OF_THE_DOOR]


def _of_plans(compared: ComparedPlans, known: Sequence[Caveat]) -> list[Caveat]:
    """Whether plans fit better otherwise; of those that a file was taken in with, that has been said."""
    return [] if any(caveat.kind == "as-is" for caveat in known) else list_plan_caveats(compared)
