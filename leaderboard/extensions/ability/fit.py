"""Stored fits: what a joint posterior says of planners and scenes, with some of its draws; a JSON file each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_key, read_json, sanitise_file_name, write_json
from benchmark.metrics.ranks import SEPARATED, assign_letters
from benchmark.records.drives import DriveRecord
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import is_baseline
from benchmark.records.store import read_records, validate_stored
from benchmark.records.stored import Stored
from leaderboard.extensions.ability.matrix import OutcomeMatrix
from leaderboard.extensions.ability.outcomes import GatheredOutcomes, Kind, Loop, Measured, gather_outcomes
from leaderboard.extensions.ability.posterior import Posterior, rank_draws

SCHEMA: Final = 1
FOLDER: Final = "abilities"
"""Below ``--out``."""
KEPT: Final = 200
"""Joint draws that are stored: what the next scenes are chosen by, and what pictures show."""
_DIGITS: Final = 6
_OF_ITEM: Final[Mapping[str, int]] = {"contact": 2, "score": 5}
"""Parameters that a scene has."""
Matrix = list[list[float]]


class PlannerAbility(Stored):
    """A planner in a fit.

    Attributes:
        name: With what tells its version from others.
        miniature: Whether it ranks nothing outside miniatures.
        reference: Whether it is a baseline or sees what no car sees, and has no rank.
        cells: Scenes that it has an outcome in.
        mean: Mean of these outcomes.
        ability: Mean ability above that of all planners of the fit, with its deviation and 95 % interval.
        expected: Expected outcome over all scenes of the matrix.
        best: First rank that is likely (95 %), among planners that are ranked together.
        worst: Last such rank.
        first: Probability of being the best of them.
        letters: Shared by those that are not told apart.
    """

    name: str
    miniature: bool
    reference: bool
    cells: int
    mean: float | None
    ability: float
    deviation: float
    low: float
    high: float
    expected: float
    best: int | None = None
    worst: int | None = None
    first: float | None = None
    letters: str = ""


class SceneDifficulty(Stored):
    """A scene in a fit.

    Attributes:
        scene: Its name.
        recording: What it was made from.
        difficulty: Ability, on the scale of the planners, at which half is expected (median); null where there are
            too few planners for parameters of scenes.
        deviation: Half the width of its 68 % interval.
        discrimination: Median slope; how much it tells.
        passed: Planners that passed: not failed, or scored above 0.
        ran: Planners that ran it.
    """

    scene: str
    recording: str
    difficulty: float | None
    deviation: float | None
    discrimination: float | None
    passed: int
    ran: int


class KeptDraws(Stored):
    """Joint draws: (K, S) abilities, (K, N) parameters of scenes, (K,) deviations of planner and recording."""

    theta: Matrix
    log_alpha: Matrix
    beta: Matrix
    omega: Matrix = Field(default_factory=list)
    g0: Matrix = Field(default_factory=list)
    apart: Matrix = Field(default_factory=list)
    sd_u: list[float] = Field(default_factory=list)


class AbilityFit(Stored):
    """``<out>/abilities/NAME.json``.

    Attributes:
        data: Name of the data set.
        fingerprint: Its content.
        split: Split.
        loop: Open or closed loop.
        world: World of the closed loop.
        kind: What a cell holds.
        seed: Seed of the sampler.
        r_hat: Largest split R-hat.
        draws: Draws of all chains.
        divergent: Divergent ones among them.
        records: Content ids of the records behind it.
        planners: By name.
        better: Probability that the planner of the row is better than that of the column.
        scenes: By name.
        values: Outcomes, null where there is none: a row a planner.
        kept: Some draws.
    """

    schema_: Literal[1] = Field(alias="schema", default=1)
    data: str
    fingerprint: str
    split: str
    loop: Loop
    world: str
    kind: Kind
    seed: int
    r_hat: float
    draws: int
    divergent: int
    records: list[str]
    planners: list[PlannerAbility]
    better: Matrix
    scenes: list[SceneDifficulty]
    values: list[list[float | None]]
    kept: KeptDraws

    @model_validator(mode="after")
    def _agree(self) -> Self:
        planners, scenes = len(self.planners), len(self.scenes)
        shapes: list[tuple[list[Any], int, int]] = [
            (self.values, planners, scenes),
            (self.better, planners, planners),
        ]
        draws = len(self.kept.theta)
        shapes += [(self.kept.theta, draws, planners)]
        items = ("log_alpha", "beta", *(("omega", "g0", "apart") if self.kind == "score" else ()))
        shapes += [(getattr(self.kept, name), draws, scenes) for name in items]
        if not draws or any(len(rows) != n or any(len(row) != m for row in rows) for rows, n, m in shapes):
            raise ValueError("its lists are of different lengths")
        if len(self.kept.sd_u) not in (0, draws):
            raise ValueError("its lists are of different lengths")
        return self

    @property
    def measured(self) -> Measured:
        """What was estimated."""
        return Measured(self.data, self.split, self.loop, self.kind, self.world)

    @property
    def matrix(self) -> OutcomeMatrix:
        """Outcomes that it was fitted to."""
        values = np.array(self.values, np.float64)
        names = tuple(planner.name for planner in self.planners)
        scenes = tuple(scene.scene for scene in self.scenes)
        return OutcomeMatrix(self.kind, names, scenes, tuple(scene.recording for scene in self.scenes), values)

    def draw(self, name: str) -> Floats:
        """(K, ...) stored draws of a parameter."""
        return np.array(getattr(self.kept, name), np.float64)

    def describe_scene(self, scene: SceneDifficulty) -> str:
        """Difficulty and discrimination in words."""
        tally = f"{scene.ran - scene.passed} of {scene.ran} planners fail"
        if scene.difficulty is None:
            return tally
        return (
            f"difficulty {scene.difficulty:.1f} ± {scene.deviation:.1f}, discrimination "
            f"{scene.discrimination:.1f} ({tally})"
        )


@dataclass(frozen=True, slots=True)
class StoredFit:
    """A fit and whether its records are the present ones."""

    fit: AbilityFit
    current: bool

    def list_scene_facts(self) -> dict[tuple[str, str, str], tuple[str, str]]:
        """A term and words for the page of each scene, by data set, split and name."""
        fit, loop = self.fit, "open loop" if self.fit.loop == "open" else "closed loop"
        term = f"ability scale, {fit.kind}, {loop}" + ("" if self.current else " (older records)")
        return {(fit.data, fit.split, scene.scene): (term, fit.describe_scene(scene)) for scene in fit.scenes}


def summarise_posterior(posterior: Posterior, gathered: GatheredOutcomes) -> AbilityFit:
    """A fit from draws, with planners that are ranked, miniatures among themselves, and references without a rank."""
    matrix, measured = posterior.matrix, gathered.measured
    contrasts, expected = posterior.contrasts, posterior.compute_expected().mean(axis=0)
    known, (passed, ran) = matrix.known, matrix.passed
    facts = [gathered.planners[name].facts for name in matrix.planners]
    ranked: dict[int, dict[str, Any]] = {}
    for miniature in (False, True):
        own = [at for at, of in enumerate(facts) if not is_baseline(of) and of.miniature == miniature]
        if len(own) > 1:
            ranks = rank_draws(contrasts[:, own])
            order = np.argsort(ranks.mean, kind="stable").tolist()
            letters = assign_letters(ranks.better > SEPARATED, order)
            for at, best, worst, first, letter in zip(own, ranks.best, ranks.worst, ranks.first, letters):
                ranked[at] = {"best": best, "worst": worst, "first": _round(first), "letters": letter}
    low, high = np.quantile(contrasts, (0.025, 0.975), axis=0)
    planners = [
        PlannerAbility(
            name=name,
            miniature=facts[at].miniature,
            reference=is_baseline(facts[at]),
            cells=int(known[at].sum()),
            mean=_round(matrix.values[at][known[at]].mean()) if known[at].any() else None,
            ability=_round(contrasts[:, at].mean()),
            deviation=_round(contrasts[:, at].std()),
            low=_round(low[at]),
            high=_round(high[at]),
            expected=_round(expected[at]),
            **ranked.get(at, {}),
        )
        for at, name in enumerate(matrix.planners)
    ]
    cells = len(matrix.planners) * len(matrix.scenes)
    enough = cells >= len(matrix.planners) + _OF_ITEM[measured.kind] * len(matrix.scenes)
    # Quantiles: where a scene tells little, its place has no mean worth printing.
    lower, middle, upper = np.quantile(posterior.middle, (0.16, 0.5, 0.84), axis=0)
    slope = np.median(np.exp(posterior.flat("log_alpha")), axis=0)
    scenes = [
        SceneDifficulty(
            scene=name,
            recording=matrix.recordings[at],
            difficulty=_round(middle[at]) if enough else None,
            deviation=_round((upper[at] - lower[at]) / 2.0) if enough else None,
            discrimination=_round(slope[at]) if enough else None,
            passed=int(passed[at]),
            ran=int(ran[at]),
        )
        for at, name in enumerate(matrix.scenes)
    ]
    draws = posterior.flat("theta")
    places = np.linspace(0, len(draws) - 1, min(KEPT, len(draws))).round().astype(int)
    kept = {name: posterior.flat(name)[places] for name in KeptDraws.model_fields if name in posterior.draws}
    return AbilityFit(
        **{name: getattr(measured, name) for name in ("data", "split", "loop", "world", "kind")},
        fingerprint=gathered.fingerprint,
        seed=posterior.seed,
        r_hat=_round(posterior.r_hat),
        draws=len(draws),
        divergent=posterior.divergent,
        records=list(gathered.records),
        planners=planners,
        better=_round_all(rank_draws(contrasts).better),
        scenes=scenes,
        values=[[None if np.isnan(value) else _round(value) for value in row] for row in matrix.values.tolist()],
        kept=KeptDraws(**{name: _round_all(values) for name, values in kept.items()}),
    )


def _round(value: float) -> float:
    return float(f"{float(value):.{_DIGITS}g}")


def _round_all(values: Floats) -> Any:
    """Nested lists of rounded numbers."""
    return np.vectorize(_round, otypes=[np.float64])(values).tolist() if values.size else values.tolist()


def find_fit_path(out: Path, measured: Measured) -> Path:
    """File of a fit; what is measured makes its name."""
    words = [measured.split, measured.loop, measured.kind]
    world = f"-{content_key(measured.world)[:8]}" if measured.world else ""
    return out / FOLDER / sanitise_file_name(measured.data) / f"{sanitise_file_name('-'.join(words))}{world}.json"


def write_fit(out: Path, fit: AbilityFit) -> Path:
    """Write a fit in place of an earlier one."""
    path = find_fit_path(out, fit.measured)
    write_json(path, fit.model_dump(mode="json", by_alias=True), indent=None)
    return path


def read_fit(path: Path) -> AbilityFit:
    """Read a fit; `InputError` where the file is damaged or of another version."""
    stored = read_json(path)
    again = "delete it, or run challenger-bench leaderboard ability again"
    return validate_stored(
        AbilityFit.model_validate,
        stored,
        lambda where, wrong: (
            f"{path} is no fit of abilities of this version ({where or 'as a whole'}: {wrong}); {again}"
        ),
    )


def list_fits(out: Path) -> list[AbilityFit]:
    """Fits below an output folder, by path."""
    return read_records(sorted((out / FOLDER).rglob("*.json")), read_fit)


def find_fits(out: Path, runs: Sequence[RunRecord], drives: Sequence[DriveRecord]) -> list[StoredFit]:
    """Fits below an output folder, by path, each with whether its records are exactly the present ones."""
    present: dict[tuple[Kind, Loop], list[GatheredOutcomes]] = {}
    found = []
    for fit in list_fits(out):
        key = fit.kind, fit.loop
        if key not in present:
            present[key] = gather_outcomes(runs, drives, *key)
        ids = {each.measured: each.records for each in present[key]}
        found.append(StoredFit(fit, ids.get(fit.measured) == tuple(fit.records)))
    return found


def require_planner(fit: AbilityFit, model: str) -> int | None:
    """Place of a planner in a fit; ``None`` where it has no record there. A name of several versions is refused."""
    names = [planner.name for planner in fit.planners]
    if model in names:
        return names.index(model)
    versions = [name for name in names if name.partition(" (")[0] == model]
    if len(versions) > 1:
        raise InputError(f"there are several versions of {model}: {', '.join(versions)}; name one of them with --model")
    return names.index(versions[0]) if versions else None
