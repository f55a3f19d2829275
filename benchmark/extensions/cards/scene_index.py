"""An index of the scenes of a data set: one row each, of what its tables and its makers say."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmark.extensions.cards.columns import Column
from benchmark.records.attempts import stored_labels

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.scene import Scene

SCENE_COLUMNS: Final = (
    Column("scene", "text", "name of the scene"),
    Column("split", "text", "custom splits that it is in, separated by commas; null where the data set names none"),
    Column("token", "text", "token of the scene in the tables"),
    Column("source_scene", "text", "recorded scene that it was made from; its own name if it is a recording"),
    Column("description", "text", "free text of the tables"),
    Column("location", "text", "location of the log, whose map is used"),
    Column("log", "text", "name of the log"),
    Column("light", "text", "light and weather that the description names, separated by commas"),
    Column("samples", "count", "2 Hz keyframes"),
    Column("frames", "count", "12 Hz frames"),
    Column("seconds", "number", "from the first frame to the last"),
    Column("ego_metres", "number", "way of the ego"),
    Column("ego_mean_m_s", "number", "its mean speed"),
    Column("agents", "count", "objects annotated at any sample"),
    Column("vehicles", "count", "of them vehicles"),
    Column("pedestrians", "count", "of them pedestrians"),
    Column("annotations", "count", "boxes at samples"),
    Column("cameras", "count", "cameras with calibration"),
    Column("has_map", "truth", "whether its location has a vector map"),
    Column("adversaries", "count", "vehicles that were made to be adversaries; null where the data set does not say"),
    Column("manoeuvre", "text", "what the first adversary does (docs/manoeuvres.md of challenger-bench)"),
    Column("place", "text", "where it comes closest: junction, straight, ..."),
    Column("closest_gap_m", "number", "smallest gap between it and the recorded ego"),
    Column(
        "careful_survives",
        "truth",
        "whether a careful and competent human (docs/severity.md there) survives it; null where nobody judged",
    ),
    Column("unsolvable", "truth", "whether nobody could have avoided it; null where nobody judged"),
    Column("review", "text", "accepted by an inspector, or not reviewed"),
)


def scene_rows(data: "DataSet") -> Iterator[dict[str, Any]]:
    """Rows of `SCENE_COLUMNS`, one a scene, in the order of names; scenes that inspectors rejected are left out.

    One scene at a time is in memory.
    """
    names = data.scene_names(None)
    facts = data.scene_facts(names)
    made: Mapping[str, Any] = (data.provenance() or {}).get("scenes", {})
    splits = data.splits()
    waiting = set(data.review(None).waiting)
    for name in names:
        scene, fact = data.scene(name), facts[name]
        judged = fact.judgement
        place, gap_m = _closest(made.get(name, {}))
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
            **_of_scene(scene),
        }


def _closest(made: Mapping[str, Any]) -> tuple[str | None, float | None]:
    """Where the first adversary that has labels comes closest, and how close; of a stranger's file anything else."""
    labels = next(iter(stored_labels(made.get("report"))), None)
    if not isinstance(labels, dict):
        return None, None
    place, approach = labels.get("place"), labels.get("closest_approach")
    gap_m = approach.get("gap_m") if isinstance(approach, dict) else None
    return (
        place if isinstance(place, str) else None,
        float(gap_m) if isinstance(gap_m, int | float) and not isinstance(gap_m, bool) else None,
    )


def _of_scene(scene: "Scene") -> dict[str, Any]:
    """Index values of a scene from the tables."""
    seen = scene.annotations.valid
    kinds = [kind for kind, there in zip(scene.agents.categories, seen.any(axis=1), strict=True) if there]
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
        "annotations": int(seen.sum()),
        "cameras": len(scene.cameras),
    }
