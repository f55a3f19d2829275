"""AlpaSim's table: whose scenes are compared, its guard, intervals of ranks, anchored scale, order and three files.

All as `e2e_challenge/local_evaluation/evaluate.py` of NVlabs/alpasim (007748ac) has it, but for the fit: scores and
deviations of a policy are given. It is not our order: a policy may stand above one with a better score.
"""

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.alpasim_table.subjects import DISTANCE, MISMATCH, Subject
from benchmark.geometry import Floats
from benchmark.machine.storage import canonical_json, write_bytes
from benchmark.untrusted.text_files import read_json

Algorithm = Literal["average", "zoib"]
"""The mean over scenes, or a zero-one-inflated Beta whose fit is given."""
MATRIX, RANKING, MANIFEST = "scene_score_matrix.csv", "capability_ranking.csv", "manifest.json"
DRAWS: Final = 100_000
LEVEL: Final = 0.95
_QUANTILES: Final = (0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
_HEADS: Final = (
    *("rank", "point_estimate_rank", "rank_lo", "rank_hi", "rank_spread", "subject_id", "is_reference"),
    *("policy_capability_score", "raw_policy_capability_score"),
    *("policy_capability_score_std", "raw_policy_capability_score_std", "average_scene_score", DISTANCE),
)


@dataclass(frozen=True, slots=True)
class Posterior:
    """Given abilities of policies: mean and standard deviation of each."""

    scores: Mapping[str, tuple[float, float]]

    @classmethod
    def read(cls, path: Path) -> "Posterior":
        """From a JSON file with lists ``subject_ids``, ``scores`` and ``score_uncertainty``; `InputError` of others."""
        stored = read_json(path)
        lists = [stored.get(name) for name in ("subject_ids", "scores", "score_uncertainty")] if stored else []
        try:
            names, means, deviations = lists
            given = {
                str(name): (float(mean), float(deviation))
                for name, mean, deviation in zip(names, means, deviations, strict=True)
            }
            numbers = np.array(list(given.values())).reshape(-1, 2)
            if len(given) != len(names) or not np.isfinite(numbers).all() or (numbers[:, 1] < 0.0).any():
                raise ValueError("names must differ, scores be finite and deviations not negative")
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{path} holds no scores and deviations ({error}); give subject_ids, scores and score_uncertainty, "
                "lists of one length"
            ) from error
        return cls(given)


@dataclass(frozen=True, slots=True)
class Anchors:
    """Reference policies, and the scores that two of them are to have."""

    references: frozenset[str]
    low: tuple[str, float]
    high: tuple[str, float]

    @classmethod
    def read(cls, path: Path) -> "Anchors":
        """From a JSON file with ``runs`` of references and ``score_scale``; `InputError` of others."""
        stored = read_json(path)
        try:
            scale = stored["score_scale"]
            low, high = (
                (str(scale[f"{end}_subject_id"]), float(scale[f"{end}_target_score"])) for end in ("low", "high")
            )
            return cls(frozenset(str(run["subject_id"]) for run in stored["runs"]), low, high)
        except (TypeError, ValueError, KeyError) as error:
            raise InputError(f"{path} has no score_scale and runs of references ({error!r}); correct it") from error


@dataclass(frozen=True, slots=True)
class AlpasimTable:
    """The files, by name, and the policies in their order."""

    files: Mapping[str, bytes]
    order: tuple[str, ...]
    warnings: tuple[str, ...]

    def write(self, folder: Path) -> list[Path]:
        """Write the files below a folder."""
        for name, data in self.files.items():
            write_bytes(folder / name, data)
        return [folder / name for name in self.files]


def build_alpasim_table(
    subjects: Sequence[Subject],
    algorithm: Algorithm = "average",
    posterior: Posterior | None = None,
    anchors: Anchors | None = None,
) -> AlpasimTable:
    """The table of some policies.

    Args:
        subjects: In any order; those with other scenes than the largest set are left out whole.
        algorithm: What is asked for; too few scores fall back to ``average``.
        posterior: Abilities of the policies that are left, for ``zoib``.
        anchors: References and their scores.

    Raises:
        InputError: If ``zoib`` has no abilities of just these policies.
    """
    scenes, included, exclusions = _select_subjects(subjects)
    used, warnings = _guard(algorithm, len(included), len(scenes))
    matrix = np.array([[subject.scores[scene] for scene in scenes] for subject in included]).astype(np.float32)
    raw, deviation = matrix.mean(axis=1, dtype=np.float64), None
    if used == "zoib":
        raw, deviation = _take_posterior(included, posterior)
    names = [subject.name for subject in included]
    scale = _anchor(names, raw, anchors)
    rows = _rank_policies(included, scenes, raw, deviation, scale)
    for row in rows:
        row["is_reference"] = anchors is not None and row["subject_id"] in anchors.references
    manifest = {
        "requested_algorithm": algorithm,
        "effective_algorithm": used,
        "scenario_count": len(scenes),
        "included_subject_ids": names,
        "exclusions": exclusions,
        "warnings": warnings,
        "rank_interval": _describe_intervals(deviation is not None),
        "score_scale": scale,
    }
    ranking = [[{"rank": rank, **row}.get(head) for head in _HEADS] for rank, row in enumerate(rows, 1)]
    cells = [[name, *values] for name, values in zip(names, matrix.tolist(), strict=True)]
    files = {
        MATRIX: _format_csv([["subject_id", *scenes], *cells]),
        RANKING: _format_csv([_HEADS, *ranking]),
        MANIFEST: canonical_json(manifest, indent=1).encode(),
    }
    order = tuple(str(row["subject_id"]) for row in rows)
    return AlpasimTable(files, order, tuple(str(warning["reason"]) for warning in warnings))


def _rank_policies(
    subjects: Sequence[Subject], scenes: Sequence[str], raw: Floats, deviation: Floats | None, scale: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Rows of the ranking by head, in its order."""
    ranks: Sequence[tuple[float, float] | None] = [None] * len(raw) if deviation is None else draw_ranks(raw, deviation)
    best = sorted(range(len(raw)), key=lambda place: (-raw[place], subjects[place].name))
    slope, offset = scale.get("scale"), scale.get("offset", 0.0)
    rows = [
        {
            "point_estimate_rank": 1 + best.index(place),
            **({} if interval is None else _describe_interval(interval)),
            "subject_id": subject.name,
            "policy_capability_score": float(raw[place]) * (1.0 if slope is None else slope) + offset,
            "raw_policy_capability_score": float(raw[place]),
            **({} if deviation is None else _describe_deviation(float(deviation[place]), slope)),
            "average_scene_score": float(np.mean([subject.scores[scene] for scene in scenes])),
            DISTANCE: subject.km_between,
        }
        for place, (subject, interval) in enumerate(zip(subjects, ranks, strict=True))
    ]
    return sorted(rows, key=_sort_key)


def draw_ranks(scores: Floats, deviations: Floats) -> list[tuple[float, float]]:
    """Ends of the 95 % interval of each rank, from normal scores that are independent of one another."""
    drawn = np.random.default_rng(0).normal(scores, deviations, (DRAWS, len(scores)))
    ranks = np.argsort(np.argsort(-drawn, axis=1), axis=1) + 1
    ends = np.quantile(ranks, _QUANTILES, axis=0, method="inverted_cdf").T
    return [(float(low), float(high)) for low, high in ends]


def _sort_key(row: Mapping[str, Any]) -> tuple[float, float, int, str]:
    """Upper rank, then the longer way between incidents, then the point estimate; without intervals the last alone."""
    point, name = row["point_estimate_rank"], row["subject_id"]
    if "rank_hi" not in row:
        return 0.0, 0.0, point, name
    return row["rank_hi"], np.inf if row[DISTANCE] is None else -row[DISTANCE], point, name


def _describe_interval(interval: tuple[float, float]) -> dict[str, float]:
    low, high = interval
    return {"rank_lo": low, "rank_hi": high, "rank_spread": high - low}


def _describe_deviation(raw: float, slope: float | None) -> dict[str, float]:
    scaled = raw if slope is None else raw * abs(slope)
    return {"policy_capability_score_std": scaled, "raw_policy_capability_score_std": raw}


def _select_subjects(subjects: Sequence[Subject]) -> tuple[list[str], list[Subject], list[dict[str, Any]]]:
    """The largest set of scenes, the more frequent of equal ones; who has it, by name, and who has not."""
    sets = Counter(frozenset(subject.scores) for subject in subjects)
    if not sets:
        raise InputError("a table needs a policy with scores; give results of at least one")
    chosen = min(sets, key=lambda scenes: (-len(scenes), -sets[scenes], sorted(scenes)))
    ordered = sorted(subjects, key=lambda subject: subject.name)
    exclusions = [
        {
            "subject_id": subject.name,
            "summary_path": subject.summary_path,
            "reason": MISMATCH,
            "scenario_count": len(subject.scores),
            "expected_scenario_count": len(chosen),
        }
        for subject in ordered
        if frozenset(subject.scores) != chosen
    ]
    return sorted(chosen), [subject for subject in ordered if frozenset(subject.scores) == chosen], exclusions


def _guard(algorithm: Algorithm, subjects: int, scenes: int) -> tuple[Algorithm, list[dict[str, Any]]]:
    """What is used, and a warning where there are fewer scores than parameters of the model."""
    observations, needed = subjects * scenes, subjects + 5 * scenes
    if algorithm == "average" or observations >= needed:
        return algorithm, []
    warning = {
        "reason": "not_enough_observations_for_requested_algorithm",
        "requested_algorithm": algorithm,
        "fallback_algorithm": "average",
        "included_submission_count": subjects,
        "scenario_count": scenes,
        "observation_count": observations,
        "minimum_observation_count": needed,
    }
    return "average", [warning]


def _take_posterior(subjects: Sequence[Subject], posterior: Posterior | None) -> tuple[Floats, Floats]:
    names = {subject.name for subject in subjects}
    given = {} if posterior is None else posterior.scores
    if set(given) != names:
        missing, more = sorted(names - set(given)), sorted(set(given) - names)
        raise InputError(
            f"zoib needs a score and a deviation of each policy (missing: {', '.join(missing) or 'none'}; not in the "
            f"table: {', '.join(more) or 'none'}); give them with --posterior, or use --algorithm average"
        )
    means, deviations = np.array([given[subject.name] for subject in subjects]).T
    return means, deviations


def _anchor(names: Sequence[str], raw: Floats, anchors: Anchors | None) -> dict[str, Any]:
    """The affine scale on which two references have their scores, or why there is none."""
    shown: dict[str, Any] = {"type": "anchor_affine", "applied": False}
    if anchors is None:
        return {**shown, "reason": "anchor_scale_not_configured"}
    (low, low_target), (high, high_target) = anchors.low, anchors.high
    if absent := [name for name in (low, high) if name not in names]:
        return {**shown, "reason": "anchor_subject_not_included", "missing_anchors": absent}
    low_raw, high_raw = (float(raw[names.index(name)]) for name in (low, high))
    if not (high_raw > low_raw and high_target > low_target):
        return {**shown, "reason": "anchor_scores_not_monotone"}
    slope = (high_target - low_target) / (high_raw - low_raw)
    return {
        **{"type": "anchor_affine", "applied": True, "scale": slope, "offset": low_target - slope * low_raw},
        **{"low_subject_id": low, "low_target_score": low_target, "low_raw_score": low_raw},
        **{"high_subject_id": high, "high_target_score": high_target, "high_raw_score": high_raw},
    }


def _describe_intervals(applied: bool) -> dict[str, Any]:
    low, high = _QUANTILES
    return {
        "kind": "posterior_rank_interval",
        "applied": applied,
        "uncertainty_source": "drive_irt_posterior_score_std",
        "nominal_confidence_level": LEVEL,
        **{"rank_lo_quantile": low, "rank_hi_quantile": high},
        **{"monte_carlo_samples": DRAWS, "monte_carlo_seed": 0},
        **({} if applied else {"reason": "algorithm_does_not_provide_posterior_score_uncertainty"}),
    }


def _format_csv(rows: Sequence[Sequence[Any]]) -> bytes:
    """CSV with the line ends of its standard, as theirs."""
    stream = io.StringIO()
    csv.writer(stream).writerows(rows)
    return stream.getvalue().encode()
