"""The card of a data set (content, origin, permitted use, what it may not show), and an index with one row a scene."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmark.constants import VERSION
from benchmark.datasets.scene_facts import find_frozen_split
from benchmark.datasets.split_names import BORROWED_NAMES
from benchmark.errors import InputError
from benchmark.extensions.cards.croissant import (
    UNKNOWN,
    DataSetDescription,
    IndexColumn,
    find_licence_page,
    format_column_rows,
    parse_licence,
)
from benchmark.extensions.cards.writing import (
    CITE,
    CROISSANT_FILE,
    CardSettings,
    WrittenCard,
    format_footer,
    write_card,
)
from benchmark.records.attempts import list_stored_labels
from benchmark.records.seed_splits import is_adversarial
from benchmark.report.table import escape_markdown
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.scene import Scene

SCENE_COLUMNS: Final = (
    IndexColumn("scene", "text", "name of the scene"),
    IndexColumn("split", "text", "custom splits that contain it, separated by commas; null if the data set names none"),
    IndexColumn("token", "text", "token of the scene in the tables"),
    IndexColumn("source_scene", "text", "recorded scene that it was made from; its own name if it is a recording"),
    IndexColumn("description", "text", "free text of the tables"),
    IndexColumn("location", "text", "location of the log, whose map is used"),
    IndexColumn("log", "text", "name of the log"),
    IndexColumn("light", "text", "light and weather that the description names, separated by commas"),
    IndexColumn("samples", "count", "2 Hz keyframes"),
    IndexColumn("frames", "count", "12 Hz frames"),
    IndexColumn("seconds", "number", "from the first frame to the last"),
    IndexColumn("ego_metres", "number", "distance driven by the ego"),
    IndexColumn("ego_mean_m_s", "number", "mean speed of the ego"),
    IndexColumn("agents", "count", "objects annotated at any sample"),
    IndexColumn("vehicles", "count", "vehicles among them"),
    IndexColumn("pedestrians", "count", "pedestrians among them"),
    IndexColumn("annotations", "count", "annotated boxes over all samples"),
    IndexColumn("cameras", "count", "cameras with calibration"),
    IndexColumn("has_map", "truth", "whether its location has a vector map"),
    IndexColumn("adversaries", "count", "vehicles that are adversaries; null if the data set does not state it"),
    IndexColumn("manoeuvre", "text", "manoeuvre of the first adversary (docs/manoeuvres.md of challenger-bench)"),
    IndexColumn("place", "text", "place of its closest approach: junction, straight, ..."),
    IndexColumn("closest_gap_m", "number", "smallest gap between it and the recorded ego"),
    IndexColumn(
        "careful_survives",
        "truth",
        "whether a careful and competent human (docs/severity.md there) survives it; null if not assessed",
    ),
    IndexColumn("unsolvable", "truth", "whether no reference driver could have avoided it; null if not assessed"),
    IndexColumn("review", "text", "accepted by an inspector, or not reviewed"),
)


def scene_rows(data: "DataSet") -> Iterator[dict[str, Any]]:
    """Rows of `SCENE_COLUMNS`, by name, one scene in memory at a time; scenes that inspectors rejected are left out."""
    names = data.scene_names(None)
    facts = data.scene_facts(names)
    scene_provenance: Mapping[str, Any] = (data.provenance() or {}).get("scenes", {})
    splits = data.splits()
    waiting = set(data.review(None).waiting)
    for name in names:
        scene, fact = data.scene(name), facts[name]
        judged = fact.judgement
        place, gap_m = _find_closest_approach(scene_provenance.get(name, {}))
        yield {
            "scene": name,
            "split": ",".join(sorted(split for split, held in splits.items() if name in held)) or None,
            "source_scene": fact.source,
            "light": ",".join(fact.light or ()) or None,
            "has_map": data.has_map(name),
            "adversaries": fact.adversaries,
            "manoeuvre": fact.manoeuvre,
            "place": place,
            "closest_gap_m": gap_m,
            "careful_survives": None if judged is None else judged.survives.get("cc"),
            "unsolvable": None if judged is None else judged.unsolvable,
            "review": "not reviewed" if name in waiting else "accepted",
            **_compute_table_values(scene),
        }


def _find_closest_approach(scene_provenance: Mapping[str, Any]) -> tuple[str | None, float | None]:
    """Where the first adversary that has labels comes closest, and how close; of a stranger's file anything else."""
    labels = next(iter(list_stored_labels(scene_provenance.get("report"))), None)
    if not isinstance(labels, dict):
        return None, None
    place, approach = labels.get("place"), labels.get("closest_approach")
    gap_m = approach.get("gap_m") if isinstance(approach, dict) else None
    return (
        place if isinstance(place, str) else None,
        float(gap_m) if isinstance(gap_m, int | float) and not isinstance(gap_m, bool) else None,
    )


def _compute_table_values(scene: "Scene") -> dict[str, Any]:
    """Index values of a scene from the tables."""
    annotated = scene.annotations.valid
    kinds = [kind for kind, there in zip(scene.agents.categories, annotated.any(axis=1), strict=True) if there]
    seconds = float(scene.timestamps_us[-1] - scene.timestamps_us[0]) * 1e-6
    metres = float(np.hypot(*np.diff(scene.ego.position[:, :2], axis=0).T).sum())
    return {
        "token": scene.token,
        "description": scene.description,
        "location": scene.road_map.location,
        "log": scene.log,
        "samples": len(scene.keyframes),
        "frames": len(scene.timestamps_us),
        "seconds": round(seconds, 6),
        "ego_metres": round(metres, 3),
        "ego_mean_m_s": round(metres / seconds, 3) if seconds > 0 else None,
        "agents": len(kinds),
        "vehicles": sum(kind.startswith("vehicle.") for kind in kinds),
        "pedestrians": sum(kind.startswith("human.") for kind in kinds),
        "annotations": int(annotated.sum()),
        "cameras": len(scene.cameras),
    }


INDEX_FILE: Final = "scenes.parquet"
TAGS: Final = ("autonomous-driving", "nuscenes", "motion-planning", "trajectories")
_SHORT_HASH: Final = 12
_OF_CACHE: Final = re.compile(r"-[0-9a-f]{12}$")


@dataclass(frozen=True, slots=True)
class _DataProvenance:
    """Origin of a data set, in sentences; `kinds` are collection types of the responsible-AI extension.

    `town` is this project's procedural one; `generated` has vehicles made to be adversaries; `borrowed` are names of
    nuScenes' own scenes, of which no command evaluates any.
    """

    collected: str
    pictures: str
    kinds: tuple[str, ...]
    town: bool
    generated: bool
    borrowed: bool


def write_data_card(
    data: "DataSet", to: Path, settings: CardSettings | None = None, *, embedded: bool = False
) -> WrittenCard:
    """Write ``README.md``, ``scenes.parquet`` and ``croissant.json`` of a data set.

    Nothing of this machine is in them, and the same data set and settings give the same bytes with the same pyarrow.

    Args:
        data: The data set, any nuScenes-format root.
        to: Folder.
        settings: Facts that the data set itself does not hold.
        embedded: Whether it is the town that comes with this project.

    Returns:
        The written files.

    Raises:
        InputError: If the data set is broken or has no scenes, or the folder cannot be written.
    """
    settings = settings or CardSettings()
    rows = list(scene_rows(data))
    if not rows:
        raise InputError(f"{data.root} has no scenes to describe; choose another data set")
    origin = _find_provenance(data.provenance() or {}, rows, embedded)
    description = _describe_data_set(data, rows, origin, settings)
    return write_card(
        to, description, _format_page(data, rows, origin, description), INDEX_FILE, "scenes", SCENE_COLUMNS, rows, TAGS
    )


def _find_provenance(
    provenance: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], embedded: bool
) -> _DataProvenance:
    source, renderer = provenance.get("source"), provenance.get("renderer")
    borrowed = provenance.get("split") == BORROWED_NAMES
    generated = any(row["adversaries"] for row in rows) or (
        not borrowed and any(row["scene"] != row["source_scene"] for row in rows)
    )
    if embedded:
        collected = "A procedural town made from a seed by challenger-bench: no recordings, no people, no real places."
    elif isinstance(source, dict):
        made_from = f"{str(source.get('name'))[:80]} (content {str(source.get('fingerprint'))[:_SHORT_HASH]})"
        collected = f"Made from the recordings {made_from} by challenger-bench."
        if borrowed:
            collected = (
                f"An export of {made_from} by challenger-bench for readers that know only nuScenes' own scenes: each "
                "has the name of a nuScenes validation scene and is not that scene."
            )
    else:
        collected = "Recordings in nuScenes format; the data set does not state how they were collected."
    frozen = find_frozen_split(provenance)
    if frozen is not None:
        collected += f" Adversaries are those of the frozen split {frozen[:80]}."
    elif generated:
        collected += " Adversaries were found by a search over simulated trajectories of recorded vehicles."
    drawn = str(renderer.get("name"))[:80] if isinstance(renderer, dict) else None
    pictures = (
        f"Images were drawn by the renderer {drawn} from boxes and maps, not taken by a camera."
        if drawn is not None
        else "The data set does not state where its images, if any, come from."
    )
    simulated = ("Software Collection",) if embedded or generated or drawn is not None else ()
    recorded = () if embedded else ("Secondary Data Analysis",)
    return _DataProvenance(collected, pictures, (*simulated, *recorded), embedded, generated, borrowed)


def _describe_data_set(
    data: "DataSet", rows: Sequence[Mapping[str, Any]], origin: _DataProvenance, settings: CardSettings
) -> DataSetDescription:
    licence = "apache-2.0" if origin.town and settings.licence is None else parse_licence(settings.licence)
    samples = sum(row["samples"] for row in rows)
    description = (
        f"{pluralise(len(rows), 'driving scene')} with {pluralise(samples, 'sample')} in nuScenes format. "
        f"{origin.collected} {origin.pictures}"
    )
    return DataSetDescription(
        name=settings.title or _name_data_set(data),
        description=description,
        licence=licence,
        url=settings.url,
        published=settings.day,
        version=f"1.0.0+{data.fingerprint()[:_SHORT_HASH]}",
        cite=CITE,
        creator=settings.creator,
        keywords=TAGS,
        responsible=_build_responsible_ai(rows, origin),
    )


def _name_data_set(data: "DataSet") -> str:
    """A name for people: the frozen split's, else the folder's without the hash that folders of the cache end in."""
    provenance = data.provenance() or {}
    name = find_frozen_split(provenance) or _OF_CACHE.sub("", data.name)
    source = provenance.get("source")
    if is_adversarial(name) and isinstance(source, dict) and source.get("name"):
        return f"{str(source['name'])[:80]} {name}"
    return name[:200]


def _build_responsible_ai(
    rows: Sequence[Mapping[str, Any]], origin: _DataProvenance
) -> dict[str, str | tuple[str, ...]]:
    """Answers to the responsible-AI extension, as far as the data set tells."""
    people = (
        "None: every road user is synthetic."
        if origin.town
        else "Positions of road users at known times and places, and, where images were taken by cameras, faces and "
        "number plates, unless they were blurred; the data set does not state it."
    )
    missing = sorted(column.name for column in SCENE_COLUMNS if any(row[column.name] is None for row in rows))
    use = (
        "Evaluation of motion planners in open loop and in closed loop.",
        *(
            ("Not for accident rates: the scenes are worst cases found by a search, not a sample of traffic.",)
            if origin.generated
            else ()
        ),
    )
    return {
        "dataCollection": f"{origin.collected} {origin.pictures}",
        "dataCollectionType": origin.kinds,
        "dataCollectionMissingData": "Columns of the index with nulls: " + (", ".join(missing) or "none") + ".",
        "dataPreprocessingProtocol": ("Scenes that inspectors rejected are left out of the index.",),
        "dataAnnotationProtocol": "Boxes come from the tables; labels of manoeuvre, place and severity are computed "
        f"by challenger-bench {VERSION} from written definitions, not assigned by people.",
        "machineAnnotationTools": (f"challenger-bench {VERSION}",),
        "dataBiases": (
            f"Locations: {_find_most_frequent(rows, 'location')}.",
            f"Light as described: {_find_most_frequent(rows, 'light')}.",
        ),
        "dataLimitations": _list_limitations(origin),
        "dataUseCases": use,
        "dataSocialImpact": "Planners that collide here need work; planners that do not are not shown to be safe.",
        "personalSensitiveInformation": (people,),
        "dataReleaseMaintenancePlan": "The version ends in a hash of the content, so it changes with the content.",
    }


def _list_limitations(origin: _DataProvenance) -> tuple[str, ...]:
    generated = (
        "Recorded road users do not react to the adversary.",
        "Adversaries were verified by the search that made them, by its own rules.",
    )
    town = ("Roads, traffic and images are simple: results here do not predict results on real roads.",)
    plain = "Motion between annotated keyframes is interpolated."
    return (plain, *(generated if origin.generated else ()), *(town if origin.town else ()))


def _find_most_frequent(rows: Sequence[Mapping[str, Any]], column: str) -> str:
    counts = Counter(str(row[column] or "not named") for row in rows)
    return ", ".join(
        f"{name} {count}" for name, count in sorted(counts.items(), key=lambda one: (-one[1], one[0]))[:12]
    )


def _format_page(
    data: "DataSet", rows: Sequence[Mapping[str, Any]], origin: _DataProvenance, description: DataSetDescription
) -> list[str]:
    """Lines of the page below its head."""
    totals = Counter[str]()
    for row in rows:
        totals.update({name: row[name] or 0 for name in ("samples", "annotations", "adversaries")})
    seconds = sum(row["seconds"] for row in rows)
    review = data.review(None).facts
    licence = (
        "Undecided: the publisher must choose one. Data derived from recordings stays under their terms."
        if description.licence == UNKNOWN
        else f"{description.licence} ({find_licence_page(description.licence)})."
    )
    manoeuvres = _find_most_frequent([row for row in rows if row["manoeuvre"]], "manoeuvre") or "none labelled"
    lines = [
        f"# {escape_markdown(description.name)}",
        "",
        escape_markdown(description.description),
        "",
        "| | |",
        "|---|---|",
        f"| scenes | {len(rows):,} |",
        f"| samples (2 Hz) | {totals['samples']:,} |",
        f"| hours | {seconds / 3600:.2f} |",
        f"| annotated boxes | {totals['annotations']:,} |",
        f"| adversaries | {totals['adversaries']:,} |",
        f"| manoeuvres of the first adversaries | {escape_markdown(manoeuvres)} |",
        f"| locations | {escape_markdown(_find_most_frequent(rows, 'location'))} |",
        f"| light, as described | {escape_markdown(_find_most_frequent(rows, 'light'))} |",
        f"| inspected by people | {_describe_review(review)} |",
        f"| content | `{data.fingerprint()}` |",
        f"| licence | {escape_markdown(licence)} |",
        "",
        "## Index",
        "",
        f"`{INDEX_FILE}` has one row a scene; `{CROISSANT_FILE}` describes it for machines. The tables, maps and",
        "images form a nuScenes-format root that the unmodified nuscenes-devkit opens.",
        "",
        *format_column_rows(SCENE_COLUMNS),
        "",
        "## Before you use it",
        "",
    ]
    for name in ("dataUseCases", "dataLimitations", "dataBiases", "personalSensitiveInformation"):
        answer = description.responsible[name]
        lines += [f"- {escape_markdown(text)}" for text in ((answer,) if isinstance(answer, str) else answer)]
    lines.append("")
    if not origin.borrowed:
        lines += ["## Evaluate a planner on it", "", "With challenger-bench installed:", "", "```"]
        lines += ["challenger-bench eval --data FOLDER --split SPLIT --model my_planner:MyPlanner", "```", ""]
    return [*lines, *format_footer()]


def _describe_review(review: Any) -> str:
    if review is None:
        return "no"
    return f"{review.accepted} accepted, {review.rejected} rejected and left out, {review.not_reviewed} not reviewed"
